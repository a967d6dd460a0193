"""Controllers tuned for several plants at once: loops, goals, procedures.

    loops/       linear sampled loops: frequency responses, margins, poles, responses, all plants side by side
    goals/       measures of loops; a new one is an entry in the `MEASURES` of a file there (see `goals.goal`)
    procedures/  how values are found; a new one keeps `procedures.procedure.Procedure` and has a block in
                 `procedures.schema`
    sources/     where plants and controllers come from

`study` has what is asked as plain values, `assembled` puts it together and checks it, `tuning` runs the procedure.
"""
