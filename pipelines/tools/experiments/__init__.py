"""Studies that measure tossid on published recordings and simulated objects, each a command of its own."""
