"""A Rauch-Tung-Striebel smoother for tracked poses: its linear system, its two passes, and a smoothed track."""
