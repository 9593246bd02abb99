/* Common parts of both plugins. */

#ifndef PQSEC_PLUGIN_H
#define PQSEC_PLUGIN_H

#include <stdlib.h>
#include <unistd.h>

#include "link.h"
#include "watch.h"

#define EXPORT __attribute__((visibility("default")))

/* Relative paths in the configuration are the host's. */
static inline bool working_folder(char *path, size_t size, struct exception *ex)
{
  if (getcwd(path, size) != NULL)
    return true;
  refuse(ex, "pqsec: the working folder cannot be told");
  return false;
}

enum { MAX_PATH = 4096 };

#endif
