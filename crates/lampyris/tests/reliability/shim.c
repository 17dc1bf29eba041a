/*
 * A disk that fails, preloaded into the service by disks.rs. It counts the writes, syncs and truncations of files whose
 * path begins with DISK_DATABASE.
 *   DISK_FAILS_AT=n   answers EIO to the nth of them. A failed sync loses what was to be synced, as file systems do: pages
 *                     that could not be written are marked clean, and the next sync succeeds without them.
 *   DISK_DIES_AT=n    the power goes at the nth: what was not synced is lost, or stays, sector by sector and by chance
 *                     (DISK_SEED), and the process is no more.
 *   DISK_FULL_WHILE=f answers ENOSPC to writes for as long as there is a file of this name.
 *   DISK_FULL_FROM=n  answers ENOSPC to writes from the nth call on.
 *   DISK_READ_ONLY=1  answers EROFS to whoever opens one of them for writing, makes or removes one.
 * DISK_TOLD names a file that is told at which call of which file it happened. Not modelled: names, such as an
 * unlink that was not synced, and what reaches files through memory maps (SQLite's -shm, which it makes anew).
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

enum { SECTOR = 512 };

/* What stood in a file before it was written to, newest first. */
struct change {
    struct change *older;
    char path[PATH_MAX];
    off_t at, size;
    size_t length;
    unsigned char before[];
};

static struct change *unsynced;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static long calls;

static long number(const char *name) {
    const char *text = getenv(name);
    return text ? atol(text) : 0;
}

static int is_in(const char *path) {
    const char *database = getenv("DISK_DATABASE");
    return database && strncmp(path, database, strlen(database)) == 0;
}

static int is_ours(int fd, char path[PATH_MAX]) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, PATH_MAX - 1);
    path[length < 0 ? 0 : length] = 0;
    return is_in(path);
}

static void tell(const char *call, const char *path) {
    int fd = open(getenv("DISK_TOLD"), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    dprintf(fd, "%s %s\n", call, path);
    close(fd);
}

static void remember(int fd, const char *path, off_t at, size_t length) {
    struct change *change = calloc(1, sizeof *change + length);
    struct stat file;
    if (!change || fstat(fd, &file) != 0) abort();
    *change = (struct change){.older = unsynced, .at = at, .size = file.st_size, .length = length};
    strcpy(change->path, path);
    syscall(SYS_pread64, fd, change->before, length, at);
    unsynced = change;
}

/* Undoes a change: of each sector with so many chances in four. */
static void undo(const struct change *change, int fd, int chances) {
    off_t end = change->at + (off_t)change->length, next;
    for (off_t at = change->at; at < end; at = next) {
        next = (at / SECTOR + 1) * SECTOR < end ? (at / SECTOR + 1) * SECTOR : end;
        if (random() % 4 < chances) syscall(SYS_pwrite64, fd, change->before + (at - change->at), next - at, at);
    }
    if (change->size < end && random() % 4 < chances) syscall(SYS_ftruncate, fd, change->size);
}

static void forget(const char *path) {
    for (struct change **link = &unsynced; *link;) {
        struct change *change = *link;
        if (strcmp(path, change->path) == 0) {
            *link = change->older;
            free(change);
        } else {
            link = &change->older;
        }
    }
}

/* The end of the process, and what a child of it then leaves on the disk: nobody sees it being done. */
static void die(const char *call, const char *path) {
    pid_t service = getpid();
    if (fork() != 0) kill(service, SIGKILL);
    while (getppid() == service) usleep(100);
    // Among others the lock of the database, which is shared with the child.
    syscall(SYS_close_range, 3, ~0U, 0);
    srandom((unsigned)number("DISK_SEED"));
    int chances = (int)(random() % 5);
    for (struct change *change = unsynced; change; change = change->older) {
        int fd = open(change->path, O_RDWR);
        if (fd >= 0) undo(change, fd, chances);
        close(fd);
    }
    tell(call, path);
    _exit(0);
}

/* Counts a call, and says whether it is the one that fails. */
static int fails(int fd, const char *call, const char *path) {
    long n = ++calls;
    if (n == number("DISK_DIES_AT")) die(call, path);
    const char *full = getenv("DISK_FULL_WHILE");
    int is_full = (full && access(full, F_OK) == 0) || (number("DISK_FULL_FROM") && n >= number("DISK_FULL_FROM"));
    if (is_full && strcmp(call, "pwrite") == 0) {
        errno = ENOSPC;
        return 1;
    }
    if (n == number("DISK_FAILS_AT")) {
        tell(call, path);
        for (struct change *change = unsynced; strstr(call, "sync") && change; change = change->older)
            if (strcmp(path, change->path) == 0) undo(change, fd, 4);
        errno = EIO;
        return 1;
    }
    return 0;
}

static int change(int fd, const char *call, long system, long a, long b, long c) {
    char path[PATH_MAX];
    pthread_mutex_lock(&lock);
    int ours = is_ours(fd, path), writes = system == SYS_pwrite64, syncs = system == SYS_fsync || system == SYS_fdatasync;
    struct stat file;
    if (ours && !strstr(path, "-shm")) {
        if (writes) remember(fd, path, c, b);
        if (system == SYS_ftruncate && fstat(fd, &file) == 0 && file.st_size > a) remember(fd, path, a, file.st_size - a);
    }
    int result = ours && fails(fd, call, path) ? -1 : (int)syscall(system, fd, a, b, c);
    int error = errno;
    if (ours && syncs) forget(path);
    pthread_mutex_unlock(&lock);
    errno = error;
    return result;
}

ssize_t pwrite(int fd, const void *data, size_t length, off_t at) { return change(fd, "pwrite", SYS_pwrite64, (long)data, length, at); }
ssize_t pwrite64(int fd, const void *data, size_t length, off_t at) { return change(fd, "pwrite", SYS_pwrite64, (long)data, length, at); }
int fsync(int fd) { return change(fd, "fsync", SYS_fsync, 0, 0, 0); }
int fdatasync(int fd) { return change(fd, "fdatasync", SYS_fdatasync, 0, 0, 0); }
int ftruncate(int fd, off_t size) { return change(fd, "ftruncate", SYS_ftruncate, size, 0, 0); }
int ftruncate64(int fd, off_t size) { return change(fd, "ftruncate", SYS_ftruncate, size, 0, 0); }

static int is_refused(const char *path) {
    if (!getenv("DISK_READ_ONLY") || !is_in(path)) return 0;
    errno = EROFS;
    return 1;
}

static int opened(const char *path, int flags, va_list rest) {
    int makes = flags & O_CREAT, mode = makes ? va_arg(rest, int) : 0;
    int writes = (flags & O_ACCMODE) != O_RDONLY || (makes && access(path, F_OK) != 0);
    if (writes && is_refused(path)) return -1;
    return (int)syscall(SYS_openat, AT_FDCWD, path, flags, mode);
}

int open(const char *path, int flags, ...) {
    va_list rest;
    va_start(rest, flags);
    int fd = opened(path, flags, rest);
    va_end(rest);
    return fd;
}

int open64(const char *path, int flags, ...) {
    va_list rest;
    va_start(rest, flags);
    int fd = opened(path, flags | O_LARGEFILE, rest);
    va_end(rest);
    return fd;
}

int unlink(const char *path) { return is_refused(path) ? -1 : (int)syscall(SYS_unlinkat, AT_FDCWD, path, 0); }
