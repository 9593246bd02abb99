/* Finds the agent's socket, and starts the agent. pqsec_pki/plugin/agent_folder.py has the same in
 * Python. PQSEC_PYTHON is the interpreter that has pqsec; it is set when this is compiled. */

#define _GNU_SOURCE
#include "agent.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#ifndef PQSEC_PYTHON
#error "compile with -DPQSEC_PYTHON=\"...\", as pqsec plugin install does"
#endif

#ifndef RUN_USER /* tests define another */
#define RUN_USER "/run/user"
#endif

enum { PATIENCE_MS = 5000 };

int agent_patience_ms(void)
{
  const char *text = secure_getenv("PQSEC_AGENT_TIMEOUT");
  long found = text != NULL ? strtol(text, NULL, 10) : 0;
  return found > 0 && found <= 600000 ? (int)found : PATIENCE_MS;
}

/* PQSEC_AGENT=private: an agent for this process only. */
static bool is_private(void)
{
  const char *mode = secure_getenv("PQSEC_AGENT");
  return mode != NULL && strcmp(mode, "private") == 0;
}

static bool is_own_folder(const char *path, mode_t forbidden)
{
  struct stat found;
  return lstat(path, &found) == 0 && S_ISDIR(found.st_mode) && found.st_uid == geteuid() &&
         (found.st_mode & forbidden) == 0;
}

/* Octets of /agent-2147483647.sock and a NUL in a socket's path. */
enum { MAX_FOLDER = 256, NAME_ROOM = 23, OF_OTHERS = 022 };
enum { SOCKET_ROOM = sizeof ((struct sockaddr_un *)0)->sun_path };

/* Whether only this user can create a folder in it. It may be a link: root creates homes. */
static bool is_good_home(const char *home)
{
  struct stat found;
  return home != NULL && home[0] == '/' && home[1] != '\0' && stat(home, &found) == 0 &&
         S_ISDIR(found.st_mode) && found.st_uid == geteuid() && (found.st_mode & OF_OTHERS) == 0 &&
         access(home, W_OK) == 0;
}

/* The first of these folders that is this user's: no other user can create files in it. */
static int find_folder(char *folder)
{
  const char *runtime = secure_getenv("XDG_RUNTIME_DIR"), *home = secure_getenv("HOME");
  char given[MAX_FOLDER];
  snprintf(given, sizeof given, RUN_USER "/%u", (unsigned)geteuid());
  if (runtime != NULL && runtime[0] == '/' && is_own_folder(runtime, 0))
    return snprintf(folder, MAX_FOLDER, "%s/pqsec", runtime);
  if (is_own_folder(given, 0))
    return snprintf(folder, MAX_FOLDER, "%s/pqsec", given);
  if (is_good_home(home) &&
      snprintf(folder, MAX_FOLDER, "%s/.pqsec", home) <= SOCKET_ROOM - NAME_ROOM)
    return 0;
  return snprintf(folder, MAX_FOLDER, "/tmp/pqsec-%u", (unsigned)geteuid());
}

bool agent_place(char *path, size_t size, struct exception *ex)
{
  char folder[MAX_FOLDER];
  if (find_folder(folder) >= MAX_FOLDER) {
    refuse(ex, "pqsec: XDG_RUNTIME_DIR is too long for a socket in it");
    return false;
  }
  if (mkdir(folder, 0700) != 0 && errno != EEXIST) {
    refuse(ex, "pqsec: %s cannot be created: %s", folder, strerror(errno));
    return false;
  }
  if (!is_own_folder(folder, 077)) {
    refuse(ex, "pqsec: %s is not a folder of this user's alone; if another user made it, set HOME "
               "or XDG_RUNTIME_DIR to folders of your own", folder);
    return false;
  }
  int more = is_private() ? snprintf(path, size, "%s/agent-%d.sock", folder, (int)getpid())
                          : snprintf(path, size, "%s/agent.sock", folder);
  if (more >= (int)size) {
    refuse(ex, "pqsec: XDG_RUNTIME_DIR is too long for a socket in it");
    return false;
  }
  return true;
}

bool agent_may_start(const char *path, int *lock)
{
  char name[SOCKET_ROOM + sizeof ".start"];
  snprintf(name, sizeof name, "%s.start", path);
  *lock = is_private() ? -1 : open(name, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (*lock < 0 || flock(*lock, LOCK_EX | LOCK_NB) == 0) /* without a file, all may */
    return true;
  close(*lock);
  *lock = -1;
  return false;
}

const char *files_seen(char *text, size_t size)
{
  char space[64];
  struct stat root;
  ssize_t length = readlink("/proc/self/ns/mnt", space, sizeof space);
  text[0] = '\0';
  if (stat("/", &root) == 0)
    snprintf(text, size, "%.*s %ju:%ju", length > 0 ? (int)length : 0, space,
             (uintmax_t)root.st_dev, (uintmax_t)root.st_ino);
  return text;
}

/* The agent gets few of the host's variables, and none for the loader, the locale or Python: later
 * hosts have it too. A host that has more rights than its user gives the agent none. */
static char **kept_environment(void)
{
  static const char *const names[] = {"HOME", "PATH", "XDG_RUNTIME_DIR", TOKENS_MODULE,
                                      TOKENS_PIN_FILE};
  static char *kept[sizeof names / sizeof *names + 1];
  size_t count = 0;
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    char *value = secure_getenv(names[i]);
    if (value != NULL)
      kept[count++] = value - strlen(names[i]) - 1; /* NAME=value */
  }
  kept[count] = NULL;
  return kept;
}

static void refuse_python(int code, struct exception *ex)
{
  if (code == ENOENT || code == ENOTDIR)
    refuse(ex, "pqsec: %s no longer exists: run `pqsec plugin install` again", PQSEC_PYTHON);
  else if (code == EACCES)
    refuse(ex, "pqsec: user %u may not execute %s, or enter a folder above it: run `pqsec plugin "
               "install` with an interpreter for all users", (unsigned)geteuid(), PQSEC_PYTHON);
  else
    refuse(ex, "pqsec: %s cannot be executed: %s", PQSEC_PYTHON, strerror(code));
}

/* The started process becomes the agent's parent and ends, so the host has no unknown child. */
pid_t agent_start(const char *path, struct exception *ex)
{
  static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
  /* No garbage collection during imports: they take a tenth less time. */
  static const char python[] = "import gc; gc.disable(); from pqsec_pki.plugin.__main__ import "
                               "start; start()";
  static const char script[] = "umask 077; cd / && exec \"$0\" -I -c \"$1\" --detach \"$2\" $3 "
                               "</dev/null >/dev/null 2>>\"${2%/*}/agent.log\"";
  if (access(PQSEC_PYTHON, X_OK) != 0) {
    refuse_python(errno, ex);
    return 0;
  }
  const char *arguments[] = {"sh", "-c", script, PQSEC_PYTHON, python, path,
                             is_private() ? "0" : "", NULL};
  posix_spawnattr_t attributes;
  sigset_t none, all;
  sigemptyset(&none);
  sigfillset(&all);
  pid_t started;
  pthread_mutex_lock(&mutex);
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF |
                                            POSIX_SPAWN_SETSID);
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setsigdefault(&attributes, &all); /* a host may ignore signals that end other processes */
  int code = posix_spawn(&started, "/bin/sh", NULL, &attributes, (char *const *)arguments,
                         kept_environment());
  posix_spawnattr_destroy(&attributes);
  pthread_mutex_unlock(&mutex);
  if (code == 0)
    return started;
  refuse(ex, "pqsec: the agent cannot be started: %s", strerror(code));
  return 0;
}
