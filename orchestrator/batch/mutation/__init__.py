"""Mutation: parameters changed by a little, to see what a suite looks after."""
