"""How likely tosses are under hypotheses, which effects are in the likeliest, and how surely."""
