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
#ifdef NETWORK
    Network network;
#endif
} Component;

#endif
