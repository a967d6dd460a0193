/* What a programmer would write by hand: five pendulums in a ring of different rates, each driven by the angle of the
 * one before; and what steps the FMU (2.0) of the same system. Both record the angles at every step. */
#include <dlfcn.h>
#include <math.h>
#include <stdlib.h>
#include <time.h>
#include "fmi2FunctionTypes.h"

#define COUNT 5

typedef struct {
    double inertia, viscous_friction, gravity_torque, coulomb_positive, coulomb_negative, stribeck_friction,
        stribeck_speed, friction_speed, equilibrium_angle;
    double torque, angle, speed;
} Pendulum;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static double acceleration(const Pendulum *p, double angle, double speed)
{
    const double direction = tanh(speed / p->friction_speed), slow = speed / p->stribeck_speed;
    const double level = 0.5 * (p->coulomb_positive + p->coulomb_negative) +
                         0.5 * (p->coulomb_positive - p->coulomb_negative) * direction +
                         p->stribeck_friction * exp(-(slow * slow));
    const double resistance = p->viscous_friction * speed + level * direction;
    return (p->torque - resistance - p->gravity_torque * sin(angle - p->equilibrium_angle)) / p->inertia;
}

static void step(Pendulum *p, double h)
{
    const double x = p->angle, v = p->speed;
    const double v1 = v, a1 = acceleration(p, x, v);
    const double v2 = v + 0.5 * h * a1, a2 = acceleration(p, x + 0.5 * h * v1, v2);
    const double v3 = v + 0.5 * h * a2, a3 = acceleration(p, x + 0.5 * h * v2, v3);
    const double v4 = v + h * a3, a4 = acceleration(p, x + h * v3, v4);
    p->angle = x + h / 6.0 * (v1 + 2.0 * (v2 + v3) + v4);
    p->speed = v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4);
}

/* `steps` steps of h [s]; pendulum i takes one of every[i] h. The record is (steps + 1, COUNT). Returns the processor's
   seconds from the first step to the last. */
double by_hand(const double *parameters, const double *angles, const long *every, double gain, long steps, double h,
               double *record)
{
    Pendulum pendulum[COUNT];
    double held[COUNT];
    for (int i = 0; i < COUNT; i++) {
        const Pendulum made = {parameters[0], parameters[1], parameters[2], parameters[3], parameters[4], parameters[5],
                               parameters[6], parameters[7], parameters[8], 0.0, angles[i], 0.0};
        pendulum[i] = made;
        held[i] = angles[i];
    }
    const double begun = now();
    for (long k = 0; k <= steps; k++) {
        for (int i = 0; i < COUNT; i++)
            *record++ = held[i];
        if (k == steps)
            break;
        for (int i = 0; i < COUNT; i++)
            if (k % every[i] == 0) {
                pendulum[i].torque = gain * held[(i + COUNT - 1) % COUNT];
                step(&pendulum[i], every[i] * h);
            }
        for (int i = 0; i < COUNT; i++)
            if ((k + 1) % every[i] == 0)
                held[i] = pendulum[i].angle;
    }
    return now() - begun;
}

static void *symbol(void *library, const char *name)
{
    void *found = dlsym(library, name);
    if (!found)
        abort();
    return found;
}

static void quiet(fmi2ComponentEnvironment e, fmi2String i, fmi2Status s, fmi2String c, fmi2String m, ...)
{
    (void)e, (void)i, (void)s, (void)c, (void)m;
}

/* The same by the FMU; a negative number where it failed. */
double by_fmu(const char *path, const char *guid, const char *resources, const fmi2ValueReference *angles, long steps,
              double h, double *record)
{
    static const fmi2CallbackFunctions callbacks = {quiet, calloc, free, NULL, NULL};
    void *library = dlopen(path, RTLD_NOW);
    if (!library)
        return -1;
    fmi2InstantiateTYPE *instantiate = symbol(library, "fmi2Instantiate");
    fmi2SetupExperimentTYPE *setup = symbol(library, "fmi2SetupExperiment");
    fmi2EnterInitializationModeTYPE *enter = symbol(library, "fmi2EnterInitializationMode");
    fmi2ExitInitializationModeTYPE *leave = symbol(library, "fmi2ExitInitializationMode");
    fmi2FreeInstanceTYPE *release = symbol(library, "fmi2FreeInstance");
    fmi2GetRealTYPE *get_real = symbol(library, "fmi2GetReal");
    fmi2DoStepTYPE *do_step = symbol(library, "fmi2DoStep");
    fmi2Component fmu = instantiate("ring", fmi2CoSimulation, guid, resources, &callbacks, fmi2False, fmi2False);
    if (!fmu)
        return -1;
    int bad = setup(fmu, fmi2False, 0, 0, fmi2False, 0) | enter(fmu) | leave(fmu) | get_real(fmu, angles, COUNT, record);
    const double begun = now();
    for (long k = 0; k < steps && !bad; k++) {
        record += COUNT;
        bad = do_step(fmu, k * h, h, fmi2True) | get_real(fmu, angles, COUNT, record);
    }
    const double seconds = now() - begun;
    release(fmu);
    return bad ? -1 : seconds;
}
