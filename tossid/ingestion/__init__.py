"""From whatever was recorded to a dataset of tosses: detect, track, segment; or import poses that others tracked."""
