/* Loaded before libc (LD_PRELOAD): from the n-th write below a folder on, the disk is full. A write is whatever takes room: data,
   a new file or folder, a new name, what fsync brings to the medium.
   TORTURE_FOLDER; TORTURE_FAIL_AT: n, 0 for never; TORTURE_COUNT: a file that gets the number of writes. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static atomic_long writes;

static int none(const char *path) {
    const char *folder = getenv("TORTURE_FOLDER"), *at = getenv("TORTURE_FAIL_AT");
    if (!folder || strncmp(path, folder, strlen(folder))) return 0;
    long which = atomic_fetch_add(&writes, 1) + 1, first = at ? atol(at) : 0;
    if (!first || which < first) return 0;
    errno = ENOSPC;
    return 1;
}

static int full(int fd) {
    struct stat about;
    char link[64], path[4096];
    if (!getenv("TORTURE_FOLDER") || fstat(fd, &about) || !S_ISREG(about.st_mode)) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n < 0) return 0;
    path[n] = 0;
    return none(path);
}

/* A name to be made; relative ones are below the working folder. */
static int unnamed(const char *name) {
    char path[4096], here[2048];
    if (!name || !getenv("TORTURE_FOLDER") || access(name, F_OK) == 0) return 0;
    if (name[0] == '/') return none(name);
    if (!getcwd(here, sizeof here)) return 0;
    snprintf(path, sizeof path, "%s/%s", here, name);
    return none(path);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
ssize_t write(int fd, const void *data, size_t size) { return full(fd) ? -1 : REAL(write)(fd, data, size); }
ssize_t pwrite(int fd, const void *data, size_t size, off_t to) { return full(fd) ? -1 : REAL(pwrite)(fd, data, size, to); }
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t to) { return full(fd) ? -1 : REAL(pwrite64)(fd, data, size, to); }
ssize_t writev(int fd, const struct iovec *parts, int count) { return full(fd) ? -1 : REAL(writev)(fd, parts, count); }

int fsync(int fd) { return full(fd) ? -1 : REAL(fsync)(fd); }
int fdatasync(int fd) { return full(fd) ? -1 : REAL(fdatasync)(fd); }
int mkdir(const char *name, mode_t mode) { return unnamed(name) ? -1 : REAL(mkdir)(name, mode); }
int rename(const char *from, const char *to) { return unnamed(to) ? -1 : REAL(rename)(from, to); }

#define OPENED(function) \
    int function(const char *name, int flags, ...) { \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = va_arg(rest, mode_t); \
        va_end(rest); \
        return (flags & O_CREAT) && unnamed(name) ? -1 : REAL(function)(name, flags, mode); \
    }
OPENED(open)
OPENED(open64)

__attribute__((destructor)) static void tell(void) {
    const char *path = getenv("TORTURE_COUNT");
    FILE *file = path && atomic_load(&writes) ? fopen(path, "a") : NULL;
    if (!file) return;
    fprintf(file, "%ld\n", atomic_load(&writes));
    fclose(file);
}
