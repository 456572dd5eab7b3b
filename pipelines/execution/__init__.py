"""Who computes: processes or a cluster, and which code it is."""
