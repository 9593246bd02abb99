/* Calls validate_remote_identity without an agent, as after its end: the token must have a class id,
 * which Cyclone DDS 0.10.2 reads when it repeats the AuthRequest. */

#include "plugin.h"

#include <stdio.h>

int init_authentication(const char *argument, void **context, void *domain);
int finalize_authentication(void *context);

typedef int (*validate)(void *, handle_t *, struct token *, const struct token *, handle_t,
                        const struct token *, const struct guid *, struct exception *);

int main(void)
{
  void *plugin;
  handle_t peer = 0;
  struct token token = {0}, none = {0};
  struct guid guid = {0};
  struct exception ex = {0};
  if (init_authentication(NULL, &plugin, NULL) != 0)
    return 1;
  struct authentication *functions = plugin;
  int result = ((validate)functions->validate_remote_identity)(plugin, &peer, &token, &none, 1,
                                                               &none, &guid, &ex);
  printf("%d '%s' %s\n", result, token.class_id != NULL ? token.class_id : "(none)", ex.message);
  free_token(&token);
  free(ex.message);
  return finalize_authentication(plugin);
}
