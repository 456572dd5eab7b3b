"""What commands draw: tables, figures in files, views in 3D."""
