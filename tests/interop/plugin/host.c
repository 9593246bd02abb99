/* A program that opens a library as ROS 2 opens its middleware, and runs what is in it.
 *
 * usage: host local|deep LIBRARY ARGUMENT... */

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

int main(int count, char **words)
{
  int deep = count > 2 && strcmp(words[1], "deep") == 0 ? RTLD_DEEPBIND : 0;
  void *library = count > 2 ? dlopen(words[2], RTLD_LAZY | RTLD_LOCAL | deep) : NULL;
  int (*run)(int, char **) = library ? (int (*)(int, char **))dlsym(library, "run") : NULL;
  if (run == NULL) {
    fprintf(stderr, "%s\n", dlerror());
    return 9;
  }
  return run(count - 2, words + 2);
}
