"""What stands around the object: tags, layouts, calibrations."""
