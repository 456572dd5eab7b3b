"""What an object's file names, states and holds."""
