"""What measures the speed and memory of tossid beside an earlier release, and where its time goes."""
