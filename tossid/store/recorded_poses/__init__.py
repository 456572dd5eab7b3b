"""What formats of recorded poses share: columns, rows, tensors, and checks of what was read."""
