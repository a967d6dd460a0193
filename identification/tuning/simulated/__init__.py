"""Controllers tuned on closed loops that are simulated: scenarios of FMUs, nonlinear as they are, and what moves show.

plants    a scenario opened once, with the controller's FMU in it, and run for values of that
moves     what goals measure of a run
problem   candidates judged
search    a simplex, from several starts
study     what is asked; `schema`, `method`: its file, and what comes of it
"""
