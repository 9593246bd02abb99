/* LD_PRELOAD: below the folder NO_LINKS there are no hard and no symbolic links, as on exFAT.
   With NO_RENAME set, renameat2(2) knows no flags there either, as below many FUSE servers. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static int is_there(int folder, const char *path)
{
    char link[64], whole[2 * PATH_MAX] = "";
    const char *below = getenv("NO_LINKS");
    if (path[0] != '/') {
        ssize_t size = 0;
        if (folder == AT_FDCWD)
            size = getcwd(whole, PATH_MAX) ? (ssize_t)strlen(whole) : 0;
        else {
            snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
            size = readlink(link, whole, PATH_MAX);
        }
        whole[size < 0 ? 0 : size] = '/';
        whole[size < 0 ? 1 : size + 1] = 0;
    }
    strncat(whole, path, PATH_MAX - 1);
    return below && !strncmp(whole, below, strlen(below));
}

#define REAL(name) ((__typeof__(name) *)dlsym(RTLD_NEXT, #name))
#define REFUSE(folder, path, code) if (is_there(folder, path)) { errno = code; return -1; }

int link(const char *old, const char *new)
{
    REFUSE(AT_FDCWD, new, EPERM)
    return REAL(link)(old, new);
}

int linkat(int from, const char *old, int to, const char *new, int flags)
{
    REFUSE(to, new, EPERM)
    return REAL(linkat)(from, old, to, new, flags);
}

int symlink(const char *target, const char *new)
{
    REFUSE(AT_FDCWD, new, ENOSYS)
    return REAL(symlink)(target, new);
}

int symlinkat(const char *target, int folder, const char *new)
{
    REFUSE(folder, new, ENOSYS)
    return REAL(symlinkat)(target, folder, new);
}

int renameat2(int from, const char *old, int to, const char *new, unsigned flags)
{
    if (getenv("NO_RENAME"))
        REFUSE(to, new, EINVAL)
    return REAL(renameat2)(from, old, to, new, flags);
}
