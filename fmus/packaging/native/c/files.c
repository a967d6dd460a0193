#include "files.h"

#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>

static FILE *open_utf8(const char *path)
{
    FILE *file = NULL;
    const int length = MultiByteToWideChar(CP_UTF8, 0, path, -1, NULL, 0);
    wchar_t *wide = length > 0 ? (wchar_t *)malloc(sizeof(wchar_t) * (size_t)length) : NULL;
    if (wide && MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, length) == length)
        file = _wfopen(wide, L"rb");
    free(wide);
    return file;
}
#else
static FILE *open_utf8(const char *path)
{
    return fopen(path, "rb");
}
#endif

FILE *open_file(const char *folder, const char *name, const char *suffix)
{
    const size_t size = strlen(folder) + strlen(name) + strlen(suffix) + 2;
    char *path = (char *)malloc(size);
    if (!path)
        return NULL;
    snprintf(path, size, "%s/%s%s", folder, name, suffix);
    FILE *file = open_utf8(path);
    free(path);
    return file;
}
