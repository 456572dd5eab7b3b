"""What the Makefile runs: demo, benchmarks, studies, the gallery."""
