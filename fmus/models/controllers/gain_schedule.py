"""A PDPC controller whose gains follow the payload: linear between the payloads of a table, its ends outside.

The payload that it goes by follows its input no faster than `payload_rate`, so that the gains do not jump, and stays
where it is while the payload is not known.
"""

from functools import lru_cache, reduce
from itertools import pairwise

from . import Model, Requirement, State, array, control, input_, ops, output, parameter


def followed(x, u, p):
    """The payload that the gains go by [kg]."""
    wanted = ops.clip(u.payload, p.payloads[0], p.payloads[-1])
    most = p.payload_rate * p.sample_time
    step = ops.clip(wanted - x.scheduled_payload, -most, most)
    return x.scheduled_payload + ops.where(u.payload_known > 0.5, step, 0.0)


def at(payload, payloads, values):
    """Of a table: its first value and what each interval adds."""
    parts = [
        (high - low) * ops.clip((payload - left) / (right - left), 0.0, 1.0)
        for (left, right), (low, high) in zip(pairwise(payloads), pairwise(values), strict=True)
    ]
    return values[0] + sum(parts)


def update(t, x, u, p):
    payload = followed(x, u, p)
    kp, kd, ks = (at(payload, p.payloads, values) for values in (p.kp, p.kd, p.ks))
    error, speed = u.reference - u.position, control.smooth_speed(x, u, p)
    effort = control.in_volts(kp * error - kd * speed - ks * u.strain, p)
    given = {"effort": effort, "scheduled_payload": payload}
    return control.compensated(effort, error, speed, x, u, p) | given


def rising(t, x, u, p):
    """Whether each payload of the table is above the one before."""
    return reduce(ops.both, [right > left for left, right in pairwise(p.payloads)])


@lru_cache(maxsize=32)
def gain_schedule(points):
    """With tables of this many payloads, at least two; at first they all have the gains of Table 4-2."""
    payloads = [0.4 * i / (points - 1) for i in range(points)]
    return Model(
        name="gain_schedule",
        description="Sampled PDPC controller whose gains follow the payload",
        variables=(
            *control.MEASURED,
            input_("payload", "kg", "Payload, as it is known or estimated"),
            input_("payload_known", "1", "Whether there is a payload to go by; 0 keeps the last one", 1.0),
            control.ENABLED,
            control.MANUAL,
            *control.VOLTAGE,
            output("effort", "V", "What the gains ask for"),
            output("compensation", "V", "What is added against dry friction"),
            output("scheduled_payload", "kg", "Payload that the gains go by"),
            *array("payloads", "kg", (points,), "Payloads of the tables, rising", payloads),
            *array("kp", "1", (points,), "Gain of the position's error at each payload", [0.5935] * points),
            *array("kd", "1", (points,), "Gain of the speed at each payload", [4.2664] * points),
            *array("ks", "1", (points,), "Gain of the strain at each payload", [0.2538] * points),
            parameter("payload_start", "kg", 0.2, "Payload that the gains go by at the start"),
            parameter("payload_rate", "kg/s", 1.0, "Fastest change of the payload that the gains go by", minimum=0),
            *control.UNIT_OF_GAINS,
            *control.FRICTION,
            control.TRANSFER_TIME,
            *control.LIMITS,
        ),
        states=(
            *control.STATES,
            State("effort", 0.0, "V", sampled=True),
            *control.OF_FRICTION,
            State("scheduled_payload", "payload_start", "kg", sampled=True),
            control.OFFSET,
        ),
        update=update,
        sample_time="sample_time",
        requirements=(Requirement(rising, "payloads do not rise from one to the next; sort the tables by them"),),
        call=f"gain_schedule({points})",
        sized=lambda shapes: gain_schedule(max(2, shapes["payloads"][0])),
        references=("The flexible-manipulator thesis, Section 4.3, Eqs. 4-6 to 4-8, with gains that vary",),
    )


MODEL = gain_schedule(3)
