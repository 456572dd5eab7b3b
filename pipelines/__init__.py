"""Commands: what knows files, keys and the tracker. One `run(cfg, console)` a command."""
