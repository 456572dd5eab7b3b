"""Camera models, rendering and reading of tag frames, detection, tracking, segmentation."""
