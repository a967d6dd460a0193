"""The pendulum thesis, Steps 1 to 4: resonances and added masses."""
