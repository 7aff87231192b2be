/* Loaded before libc (LD_PRELOAD): from the n-th write into a file below a folder on, the disk is full.
   TORTURE_FOLDER; TORTURE_FAIL_AT: n, 0 for never; TORTURE_COUNT: a file that gets the number of writes. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static atomic_long writes;

static int full(int fd) {
    const char *folder = getenv("TORTURE_FOLDER"), *at = getenv("TORTURE_FAIL_AT");
    struct stat about;
    char link[64], path[4096];
    if (!folder || fstat(fd, &about) || !S_ISREG(about.st_mode)) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n < 0) return 0;
    path[n] = 0;
    if (strncmp(path, folder, strlen(folder))) return 0;
    long which = atomic_fetch_add(&writes, 1) + 1, first = at ? atol(at) : 0;
    if (!first || which < first) return 0;
    errno = ENOSPC;
    return 1;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
ssize_t write(int fd, const void *data, size_t size) { return full(fd) ? -1 : REAL(write)(fd, data, size); }
ssize_t pwrite(int fd, const void *data, size_t size, off_t to) { return full(fd) ? -1 : REAL(pwrite)(fd, data, size, to); }
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t to) { return full(fd) ? -1 : REAL(pwrite64)(fd, data, size, to); }
ssize_t writev(int fd, const struct iovec *parts, int count) { return full(fd) ? -1 : REAL(writev)(fd, parts, count); }

__attribute__((destructor)) static void tell(void) {
    const char *path = getenv("TORTURE_COUNT");
    FILE *file = path && atomic_load(&writes) ? fopen(path, "a") : NULL;
    if (!file) return;
    fprintf(file, "%ld\n", atomic_load(&writes));
    fclose(file);
}
