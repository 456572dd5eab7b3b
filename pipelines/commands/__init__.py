"""One module a command: `run(config, console) -> dict`."""
