"""A brushed DC motor: Eq. 4, or with zero inductance the static reduction that Eq. 5 uses.

    L i' = v - R i - back_emf w,    torque = k_i i,    k_i = torque_gain R   (torque_gain is p4 = k_i / R of Eq. 6)

`back_emf` is the constant k_emf; the armature voltage is the input within the limits of the amplifier, which also stops
the current from growing beyond its limit.
"""

from . import Model, State, input_, ops, output, parameter, port


def armature_voltage(u, p):
    """What drives the current, after the amplifier's limit and the back electromotive force."""
    return ops.clip(u.voltage, -p.voltage_limit, p.voltage_limit) - p.back_emf * u.speed


def current(x, u, p):
    free = ops.where(p.inductance > 0, x.inductor_current, armature_voltage(u, p) / p.resistance)
    return ops.clip(free, -p.current_limit, p.current_limit)


def derivatives(t, x, u, p):
    remaining = armature_voltage(u, p) - p.resistance * x.inductor_current
    at_limit = ops.both(ops.absolute(x.inductor_current) >= p.current_limit, remaining * x.inductor_current > 0)
    rate = ops.where(at_limit, 0.0, remaining) / ops.where(p.inductance > 0, p.inductance, 1.0)
    return {"inductor_current": ops.where(p.inductance > 0, rate, 0.0)}


def outputs(t, x, u, p):
    amperes = current(x, u, p)
    return {"torque": p.torque_gain * p.resistance * amperes, "current": amperes}


def solver_step(p):
    """A fifth of the electrical time constant L/R."""
    return ops.where(p.inductance > 0, 0.2 * p.inductance / p.resistance, 0.01)


MODEL = Model(
    name="dc_motor",
    description="Brushed DC motor with amplifier limits; static when the inductance is 0",
    variables=(
        input_("voltage", "V", "Commanded armature voltage"),
        input_("speed", "rad/s", "Angular velocity of the shaft"),
        output("torque", "N.m", "Torque on the shaft"),
        output("current", "A", "Armature current"),
        parameter("torque_gain", "N.m/V", 10.0, "Torque per volt at standstill (p4 = k_i/R)"),
        parameter("resistance", "Ohm", 1.0, "Armature resistance (R)", minimum=1e-9),
        parameter("inductance", "H", 0.0, "Armature inductance (L); 0 leaves the electrical mode out", minimum=0),
        parameter("back_emf", "V.s/rad", 0.0, "Back electromotive force per speed (k_emf)", minimum=0),
        parameter("voltage_limit", "V", 1e6, "Largest armature voltage, either sign", minimum=0),
        parameter("current_limit", "A", 1e6, "Largest armature current, either sign", minimum=0),
    ),
    ports=(
        port("armature", "electrical", voltage="voltage", current="current"),
        port("shaft", "rotational", outward=True, speed="speed", torque="torque"),
    ),
    states=(State("inductor_current", 0.0, "A", description="Armature current when the inductance is not 0"),),
    derivatives=derivatives,
    outputs=outputs,
    solver_step=solver_step,
    references=("Angelchev Shiryaev, Umea University 2024, Eqs. 4-6",),
)
