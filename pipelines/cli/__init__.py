"""The command line itself: commands and options, help, completion, console, failures."""
