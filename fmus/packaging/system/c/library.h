/* Libraries that are loaded while running; apart from the rest, because the headers of Windows define names of ours. */
#ifndef LIBRARY_H
#define LIBRARY_H

#if defined __aarch64__ || defined _M_ARM64
#define PROCESSOR "aarch64"
#define LINUX "aarch64-linux"
#else
#define PROCESSOR "x86_64"
#define LINUX "linux64"
#endif

/* Where an FMU of version 2 or 3 has the library of this platform, and what its name ends with. */
#if defined _WIN32
#define LIBRARY_FOLDER_2 "win64"
#define LIBRARY_FOLDER_3 PROCESSOR "-windows"
#define LIBRARY_SUFFIX ".dll"
#elif defined __APPLE__
#define LIBRARY_FOLDER_2 "darwin64"
#define LIBRARY_FOLDER_3 PROCESSOR "-darwin"
#define LIBRARY_SUFFIX ".dylib"
#else
#define LIBRARY_FOLDER_2 LINUX
#define LIBRARY_FOLDER_3 PROCESSOR "-linux"
#define LIBRARY_SUFFIX ".so"
#endif

typedef struct {
    char text[400];
} LibraryProblem;

/* The library of a path in UTF-8; NULL, and why, where it cannot be loaded. It stays loaded as long as the process:
 * many libraries do not survive that they are unloaded. */
void *library_load(const char *path, LibraryProblem *problem);

/* Have the pointer to a function at `to` be that of this name, NULL where there is none. Whether there is one. */
int library_find(void *library, const char *name, void *to);

#endif
