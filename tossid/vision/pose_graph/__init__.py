"""From tag corners to poses: the factor graph and what checks it."""
