/* Opening files; apart from the rest, because the headers of Windows define names that models use. */
#ifndef FILES_H
#define FILES_H

#include <stdio.h>

/* The file `<folder>/<name><suffix>`, opened for reading; all are UTF-8. NULL without memory or without such a file. */
FILE *open_file(const char *folder, const char *name, const char *suffix);

#endif
