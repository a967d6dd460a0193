"""Linear models: modes, poles, reduction and updating.

For notebooks, beside what the studies use: `LinearModel` and `InputOutputData`, `modes.modes` with MSV, MRM and the
bound that MRM sets (`dropping_bound`), `poles.constrained` and `stabilised`, `updating.reduced`, `set_point.followed`.
"""
