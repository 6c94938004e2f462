/* SPDX-License-Identifier: Apache-2.0
 * A disk that fails, for LD_PRELOAD. FAULT_NAME is a part of a path; once the file FAULT_AFTER
 * exists (or at once without it), what touches such a path fails: FAULT_KIND is "readonly" (nothing
 * can be made, changed or removed), "write" (written blocks are bad), "read" (read ones are) or
 * "gone" (a network drive that went away: nothing works). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static int is_on(const char *kind) {
  const char *wanted = getenv("FAULT_KIND"), *after = getenv("FAULT_AFTER");
  struct stat found;
  if (!wanted || strcmp(wanted, kind)) return 0;
  return !after || !*after || REAL(stat)(after, &found) == 0;
}

static int is_meant(const char *path) {
  const char *name = getenv("FAULT_NAME");
  return path && name && *name && strstr(path, name) != NULL;
}

static int is_meant_file(int file) {
  char link[64], path[PATH_MAX];
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  ssize_t size = readlink(link, path, sizeof path - 1);
  if (size < 0) return 0;
  path[size] = 0;
  return is_meant(path);
}

static int fails(const char *path, const char *kind, int error) {
  if (!is_on(kind) || !is_meant(path)) return 0;
  errno = error;
  return 1;
}

static int is_gone(const char *path) { return fails(path, "gone", ESTALE); }

#define OPEN(name)                                                                   \
  int name(const char *path, int flags, ...) {                                       \
    va_list words;                                                                   \
    va_start(words, flags);                                                          \
    mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(words, mode_t) : 0;         \
    va_end(words);                                                                   \
    int is_change = flags & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC);                 \
    if (is_gone(path) || (is_change && fails(path, "readonly", EROFS))) return -1;   \
    return REAL(name)(path, flags, mode);                                            \
  }
OPEN(open)
OPEN(open64)

#define FOPEN(name)                                                                  \
  FILE *name(const char *path, const char *mode) {                                   \
    int is_change = strpbrk(mode, "wa+") != NULL;                                    \
    if (is_gone(path)) return NULL;                                                  \
    if (is_change && (fails(path, "readonly", EROFS) || fails(path, "write", EIO)))  \
      return NULL;                                                                   \
    return !is_change && fails(path, "read", EIO) ? NULL : REAL(name)(path, mode);   \
  }
FOPEN(fopen)
FOPEN(fopen64)

int mkdir(const char *path, mode_t mode) {
  return is_gone(path) || fails(path, "readonly", EROFS) ? -1 : REAL(mkdir)(path, mode);
}
int unlink(const char *path) {
  return is_gone(path) || fails(path, "readonly", EROFS) ? -1 : REAL(unlink)(path);
}
int rmdir(const char *path) {
  return is_gone(path) || fails(path, "readonly", EROFS) ? -1 : REAL(rmdir)(path);
}
int rename(const char *from, const char *to) {
  return is_gone(to) || fails(to, "readonly", EROFS) ? -1 : REAL(rename)(from, to);
}
int stat(const char *path, struct stat *found) {
  return is_gone(path) ? -1 : REAL(stat)(path, found);
}

static int is_bad(int file, const char *kind, int error) {
  if (!is_on(kind) || !is_meant_file(file)) return 0;
  errno = error;
  return 1;
}

/* What is open already cannot be written either once a disk is read-only. */
static int is_bad_to_write(int file) {
  return is_bad(file, "write", EIO) || is_bad(file, "readonly", EROFS) || is_bad(file, "gone", ESTALE);
}
ssize_t write(int file, const void *data, size_t size) {
  return is_bad_to_write(file) ? -1 : REAL(write)(file, data, size);
}
ssize_t writev(int file, const struct iovec *data, int count) {
  return is_bad_to_write(file) ? -1 : REAL(writev)(file, data, count);
}
ssize_t read(int file, void *data, size_t size) {
  if (is_bad(file, "read", EIO) || is_bad(file, "gone", ESTALE)) return -1;
  return REAL(read)(file, data, size);
}
