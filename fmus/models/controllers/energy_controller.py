"""Orbital stabilisation of a pendulum by its energy: friction compensation (Eq. 103) and energy feedback (Eq. 109).

    v = p2/p4 w - gain w (E - E*),   E = p1/2 w^2 + p3 (1 - cos(angle - equilibrium)),   E* = p3 (1 - cos amplitude)

Lemma 8 excludes the energies of the two equilibria, 0 and 2 p3: from there, or towards there, it proves nothing (at
rest the feedback is zero for ever). The text joins the two conditions by "or"; both must hold.

It proves nothing either where the voltage is at its limit, is late, or friction is not what is compensated. Then the
energy may stay elsewhere, above all with an amplitude near pi, where little more takes the pendulum over the top;
`saturated` and `unreached` tell so.
"""

import math

from . import Model, Requirement, State, input_, ops, output, parameter


def energy(u, p):
    """Eq. 105."""
    return 0.5 * p.p1 * u.speed**2 + p.p3 * (1 - ops.cos(u.angle - p.equilibrium_angle))


def target_energy(p):
    return p.p3 * (1 - ops.cos(p.amplitude))


def update(t, x, u, p):
    sampled = energy(u, p)
    away = sampled - target_energy(p)
    asked = p.p2 / p.p4 * u.speed - p.gain * u.speed * away
    waited = ops.where(ops.absolute(away) > p.tolerance * target_energy(p), x.waited + p.sample_time, 0.0)
    return {
        "voltage": ops.clip(asked, -p.voltage_limit, p.voltage_limit),
        "saturated": ops.where(ops.absolute(asked) > p.voltage_limit, 1.0, 0.0),
        "energy": sampled,
        "waited": waited,
        "unreached": ops.where(waited > p.patience, 1.0, 0.0),
    }


def apart(energy, equilibrium_energy, p):
    """Whether two energies differ by more than a millionth of the way between the equilibria."""
    return ops.absolute(energy - equilibrium_energy) > 2e-6 * p.p3


MODEL = Model(
    name="energy_controller",
    description="Energy feedback that stabilises the oscillation of a pendulum with a given amplitude",
    variables=(
        input_("angle", "rad", "Angle of the pendulum"),
        input_("speed", "rad/s", "Angular velocity of the pendulum"),
        output("voltage", "V", "Motor voltage, held between samples"),
        output("energy", "J", "Energy by the controller's model (Eq. 105), held between samples"),
        output("saturated", "1", "1 while the voltage is at its limit and more is asked for"),
        output("unreached", "1", "1 while the energy has been away from the wanted one for longer than `patience`"),
        parameter("p1", "kg.m2", 0.00325, "Moment of inertia about the axis", minimum=0),
        parameter("p2", "N.m.s/rad", 0.001, "Viscous friction with the motor's back-EMF, to be compensated", minimum=0),
        parameter("p3", "N.m", 0.04905, "Weight times distance of the centre of mass", minimum=1e-12),
        parameter("p4", "N.m/V", 10.0, "Torque per volt"),
        parameter("gain", "V.s/(rad.J)", 0.1, "Energy feedback (gamma)", minimum=0),
        parameter(
            "amplitude",
            "rad",
            1.0,
            "Largest inclination of the wanted oscillation (theta_max)",
            minimum=0,
            maximum=math.pi,
        ),
        parameter("equilibrium_angle", "rad", 0.0, "Angle of the downward equilibrium"),
        parameter("sample_time", "s", 0.005, "Sample period", minimum=1e-6),
        parameter("tolerance", "1", 0.05, "Of the wanted energy, within which it is reached", minimum=0),
        parameter("patience", "s", 10.0, "How long it may take until it is", minimum=0),
        parameter("voltage_limit", "V", 1e6, "Largest voltage, either sign", minimum=0),
    ),
    states=(
        State("voltage", 0.0, "V", sampled=True),
        State("saturated", 0.0, sampled=True),
        State("energy", 0.0, "J", sampled=True),
        State(
            "waited", 0.0, "s", sampled=True, description="For how long the energy has been away from the wanted one"
        ),
        State("unreached", 0.0, sampled=True),
    ),
    update=update,
    sample_time="sample_time",
    requirements=(
        Requirement(
            lambda t, x, u, p: apart(energy(u, p), 0.0, p),
            "start energy is that of the downward equilibrium, where the feedback is zero (Lemma 8); start elsewhere",
        ),
        Requirement(
            lambda t, x, u, p: apart(energy(u, p), 2 * p.p3, p),
            "start energy is that of the upright equilibrium, 2 p3 (Lemma 8); start elsewhere",
        ),
        Requirement(
            lambda t, x, u, p: apart(target_energy(p), 0.0, p),
            "amplitude asks for the energy of the downward equilibrium (Lemma 8); give one between 0 and pi",
        ),
        Requirement(
            lambda t, x, u, p: apart(target_energy(p), 2 * p.p3, p),
            "amplitude asks for the energy of the upright equilibrium, 2 p3 (Lemma 8); give one between 0 and pi",
        ),
    ),
    references=("Angelchev Shiryaev, Umea University 2024, Eqs. 103, 105, 109, Lemma 8",),
)
