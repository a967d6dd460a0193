"""Linear models: modes, poles, reduction and updating."""
