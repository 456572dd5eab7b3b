"""tossid: learn an object's contact and continuous dynamics from its tosses, and why a simulator is wrong about it."""
