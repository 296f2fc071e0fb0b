"""Map servo ticks to a model's commands, with uncertainties and held-out checks."""
