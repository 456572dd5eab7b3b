"""Where the gap lies: phases, channels, missing forces, corners."""
