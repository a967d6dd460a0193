/* What an importer of FMI 3.0 has as a component. */
#ifndef FMI3_COMPONENT_H
#define FMI3_COMPONENT_H

#include "fmi3Functions.h"

#include "instance.h"

#ifdef NETWORK
#include "network.h"
#endif

typedef struct {
    Instance instance; /* first, so that a pointer to it is one to the component */
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    int events;  /* whether the importer has event mode, in co-simulation with clocks; without it a bus exchanges nothing */
    int ticking; /* whether the clock of samples ticks in this event */
    int told;    /* whether its interval has been told */
#ifdef NETWORK
    Network network;
#endif
} Component;

#endif
