"""Training: `train` fits a model to tosses, stage by stage; `uncertainty` has intervals of what it learned."""
