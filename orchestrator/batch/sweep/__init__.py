"""A scenario run at many points: what varies, how points are chosen, who runs them, and the rows that come out."""
