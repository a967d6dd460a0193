/* An FMU within a system: a part like those made of models, whose functions are those of its own library.
 *
 * It lies unpacked in a folder of the resources. What it is asked for, and when, is what orchestrator/fmi/instance.py and
 * slave.py ask for, so that it gives the same as wired: inputs are written and outputs read, a call for each type of
 * values, before and after each step; a parameter is set where somebody gives it a value, and only then.
 */
#ifndef NESTED_H
#define NESTED_H

#include "library.h"
#include "system.h"

typedef enum { REAL_VALUE, WHOLE_VALUE, TRUTH_VALUE, ITEM_VALUE, KINDS } Kind; /* an item is one of an enumeration */
typedef enum { GIVEN, DRIVEN, FREE, READ } Use; /* a parameter; an input with a wire, or none; what is read */

typedef struct {
    unsigned reference; /* in the FMU itself */
    Kind kind;
    Use use;
    int size; /* how many values are behind it: all of an array behind its first element, none behind others */
} NestedVariable;

typedef struct Nested Nested;

/* How a step went beside its status: whether the FMU wants to be stepped no more, or came back early, and when [s]. */
typedef struct {
    int asked, early;
    double reached;
} Stop;

/* The functions of either version of FMI, behind one face; those that give a number give FMI's status. */
typedef struct {
    const char *folder;                 /* of the library, in `binaries` */
    Status (*bind)(Nested *part);       /* find the functions */
    Status (*instantiate)(Nested *part);
    void (*release)(Nested *part);      /* the instance */
    int (*reset)(Nested *part);
    int (*enter)(Nested *part);
    int (*leave)(Nested *part);
    int (*terminate)(Nested *part);
    int (*set)(Nested *part, Kind kind, const unsigned references[], size_t count, const double values[], size_t n);
    int (*get)(Nested *part, Kind kind, const unsigned references[], size_t count, double values[], size_t n);
    int (*step)(Nested *part, double time, double duration, Stop *stop);
    int (*save)(Nested *part, void **state);
    int (*restore)(Nested *part, void *state);
    int (*drop)(Nested *part, void **state);
} NestedFunctions;

extern const NestedFunctions nested_fmi2, nested_fmi3;
extern const PartModel nested_part;

struct NestedFmu {
    const NestedFunctions *functions;
    const char *identifier, *token;
    const char *const *categories; /* of messages about trouble; NULL after them */
    int saves;                     /* whether it can go back to a state */
    int once;                      /* whether there may be one instance in a process only */
    const NestedVariable *variables;
};

/* Variables that are written or read together: those of a kind lie side by side, from these places on. */
typedef struct {
    size_t first[KINDS + 1], first_reference[KINDS + 1];
    unsigned *references;
    int *places;
    double *numbers;
} Bundle;

typedef enum { MADE, INITIALISING, RUNNING } Phase;

struct Nested {
    const NestedFmu *fmu;
    Instance *owner;
    int number; /* among the parts */
    PartReport *listener;
    char *folder;
    void *library, *instance;
    void *functions; /* of its version of FMI */
    void *callbacks;
    void *scratch; /* room for as many values as there are variables, of any type */
    double *values;
    unsigned char *given; /* of each variable, whether somebody gave it a value */
    Bundle reads, writes;
    Phase phase;
    double start;
    int touched;    /* since it was instantiated or reset */
    int asked;      /* to stop at the end of the latest step */
    int complained; /* it has logged an error */
    int dead;       /* none of its functions may be called again */
};

/* Say something in the name of the part. */
void nested_say(Nested *part, Status status, const char *format, ...);

/* Pass on what the FMU says, with its status. */
void nested_said(Nested *part, int status, const char *category, const char *text);

/* The whole number next to a value; 0, and it is said, where it does not fit into 32 bits. */
int nested_whole(Nested *part, double value, int *number);

/* Say that the library lacks a function. */
Status nested_lacks(Nested *part, const char *function);

/* "<folder><path>" as a new string, as a URI where asked for. NULL without memory. */
char *nested_place(const Nested *part, const char *path, int as_uri);

#endif
