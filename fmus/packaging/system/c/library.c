#include "library.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>

void *library_load(const char *path, LibraryProblem *problem)
{
    HMODULE found = NULL;
    const int length = MultiByteToWideChar(CP_UTF8, 0, path, -1, NULL, 0);
    wchar_t *wide = length > 0 ? (wchar_t *)malloc(sizeof(wchar_t) * (size_t)length) : NULL;
    if (wide && MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, length) == length) {
        for (wchar_t *c = wide; *c; c++)
            if (*c == L'/')
                *c = L'\\'; /* or what it needs is not looked for beside it */
        found = LoadLibraryExW(wide, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
    }
    free(wide);
    if (!found)
        snprintf(problem->text, sizeof problem->text, "error %lu of Windows", (unsigned long)GetLastError());
    return (void *)found;
}

int library_find(void *library, const char *name, void *to)
{
    const FARPROC found = GetProcAddress((HMODULE)library, name);
    memcpy(to, &found, sizeof found);
    return found != NULL;
}
#else
#include <dlfcn.h>

void *library_load(const char *path, LibraryProblem *problem)
{
    void *found = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    const char *said = found ? NULL : dlerror();
    if (!found)
        snprintf(problem->text, sizeof problem->text, "%s", said ? said : "no reason is given");
    return found;
}

int library_find(void *library, const char *name, void *to)
{
    void *const found = dlsym(library, name);
    memcpy(to, &found, sizeof found);
    return found != NULL;
}
#endif
