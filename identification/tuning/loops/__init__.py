"""Linear sampled loops of one controller around many plants at once: frequency responses, margins, poles, responses."""
