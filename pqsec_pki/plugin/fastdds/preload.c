/* LD_PRELOAD loads this library. It defines the functions with which Fast DDS creates its security
 * plugins, and returns those of the adapter that was compiled for exactly that library.
 *
 * It needs only libc, so it does not disturb a shell or an interpreter that never loads Fast DDS. If
 * there is no adapter, it returns plugins that refuse. NULL would be wrong: Fast DDS then runs
 * without security. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <link.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))
#define ADVICE "; run `pqsec plugin install fastdds`"

enum { MAX_ID = 32, MAX_PATH = 4096, MAX_ADAPTERS = 8 };

/* The functions of Fast DDS 2.x and 3.x, by their names in the library. */
#define FACTORY(space, which) \
  "_ZN8eprosima" space "4rtps8security21SecurityPluginFactory" which "ERKNS1_14PropertyPolicyE"
#define SIZE(space) \
  "_ZN8eprosima" space "4rtps16DataHolderHelper15serialized_sizeERKSt6vectorINS1_10DataHolderESaIS4_EEm"
#define DISCOVERY(space, function) "_ZN8eprosima" space "4rtps" function
#define NOTIFY(space) \
  DISCOVERY(space, "9PDPSimple26notifyAboveRemoteEndpointsERKNS1_20ParticipantProxyDataEb")
#define KEEP(space) \
  DISCOVERY(space, "9PDPSimple26createParticipantProxyDataERKNS1_20ParticipantProxyDataERKNS1_6GUID_tE")
#define ANNOUNCE(space) \
  DISCOVERY(space, "3PDP39notify_and_maybe_ignore_new_participantEPNS1_20ParticipantProxyDataERb")
#define CONNECT(space) \
  DISCOVERY(space, "9PDPSimple33assign_low_level_remote_endpointsERKNS1_20ParticipantProxyDataEb")
#define INITIALIZE(space) \
  DISCOVERY(space, "9PDPSimple30initializeParticipantProxyDataEPNS1_20ParticipantProxyDataE")
#define REPEAT(space) \
  DISCOVERY(space, "9PDPSimple24announceParticipantStateEbbRNS1_11WriteParamsE")
#define REMOVE(space, status) \
  DISCOVERY(space, "3PDP25remove_remote_participantERKNS1_6GUID_tENS1_" status)
#define STATUS_2 "24ParticipantDiscoveryInfo16DISCOVERY_STATUSE"
#define STATUS_3 "26ParticipantDiscoveryStatusE"
#define IN_2 "8fastrtps"
#define IN_3 "7fastdds"
#define AUTHENTICATION "28create_authentication_plugin"
#define ACCESS_CONTROL "28create_access_control_plugin"

typedef void *(*factory)(void *self, const void *policy);
typedef void *(*maker)(const void *policy, factory original, void *self);
typedef bool (*prober)(void);
typedef size_t (*sizer)(const void *tokens, size_t alignment);
typedef void (*connector)(void *self, const void *peer, bool secure);
typedef void *(*keeper)(void *self, const void *peer, const void *writer);
typedef void (*announcer)(void *self, void *peer, bool *ignore);
typedef void (*initializer)(void *self, void *data);
typedef void (*repeater)(void *self, bool fresh, bool dispose, void *parameters);
typedef bool (*remover)(void *self, const uint8_t *guid, int status);
typedef void (*maker_seen)(const void *discovery);
typedef void (*loser)(const void *discovery, void (*drop)(void *, const uint8_t *), void *context);

/* ---- Plugins that refuse: objects with a table of virtual functions, as C++ lays them out. */

enum { BEFORE = 2, SLOTS = 40, ROOM = 240 };

struct refusing { const void *const *table; uint8_t room[ROOM]; };

static uintptr_t validation_failed(void) { return 1; } /* ValidationResult_t */
static uintptr_t nothing(void) { return 0; }           /* false, or no handle */
static void destroy(void *object) { (void)object; }

#define FOUR(f) (const void *)(f), (const void *)(f), (const void *)(f), (const void *)(f)
#define TABLE(f)                                                                      \
  {                                                                                   \
    NULL, NULL, (const void *)destroy, (const void *)free, FOUR(f), FOUR(f), FOUR(f), \
        FOUR(f), FOUR(f), FOUR(f), FOUR(f), FOUR(f), FOUR(f)                          \
  }

static const void *const no_authentication[BEFORE + SLOTS] = TABLE(validation_failed);
static const void *const no_access_control[BEFORE + SLOTS] = TABLE(nothing);

struct plugin { const char *maker; const void *const *refusing; };

static const struct plugin authentication = {"pqsec_authentication", no_authentication};
static const struct plugin access_control = {"pqsec_access_control", no_access_control};

static void *refuse(const struct plugin *plugin, const char *why, const char *library)
{
  fprintf(stderr, "pqsec: Fast DDS makes no secured participant: %s %s%s\n", why, library, ADVICE);
  struct refusing *object = calloc(1, sizeof *object);
  if (object == NULL)
    abort(); /* neither a plugin nor a refusal can be given */
  object->table = plugin->refusing + BEFORE;
  return object;
}

/* ---- The library that calls, and its build ID */

struct caller { uintptr_t address; const char *name; char id[2 * MAX_ID + 1]; };

static void read_id(struct caller *caller, const ElfW(Nhdr) *note, const uint8_t *value)
{
  for (uint32_t i = 0; i < note->n_descsz && i < MAX_ID; i++)
    snprintf(caller->id + 2 * i, 3, "%02x", value[i]);
}

static void read_notes(struct caller *caller, const uint8_t *at, size_t left, size_t align)
{
  while (left >= sizeof(ElfW(Nhdr))) {
    const ElfW(Nhdr) *note = (const void *)at;
    size_t value = (sizeof *note + note->n_namesz + align - 1) / align * align;
    size_t size = (value + note->n_descsz + align - 1) / align * align;
    if (value + note->n_descsz > left)
      return;
    if (note->n_type == NT_GNU_BUILD_ID && note->n_namesz == sizeof "GNU" &&
        memcmp(note + 1, "GNU", sizeof "GNU") == 0)
      read_id(caller, note, at + value);
    if (size > left)
      return;
    at += size;
    left -= size;
  }
}

static int look(struct dl_phdr_info *info, size_t size, void *data)
{
  struct caller *caller = data;
  bool inside = false;
  (void)size;
  for (int i = 0; i < info->dlpi_phnum; i++) {
    const ElfW(Phdr) *each = info->dlpi_phdr + i;
    uintptr_t start = info->dlpi_addr + each->p_vaddr;
    inside |= each->p_type == PT_LOAD && caller->address - start < each->p_memsz;
  }
  if (!inside)
    return 0;
  caller->name = info->dlpi_name;
  for (int i = 0; i < info->dlpi_phnum; i++) {
    const ElfW(Phdr) *each = info->dlpi_phdr + i;
    if (each->p_type == PT_NOTE)
      read_notes(caller, (const uint8_t *)(info->dlpi_addr + each->p_vaddr), each->p_memsz,
                 each->p_align == 8 ? 8 : 4);
  }
  return 1;
}

static struct caller caller_at(const void *address)
{
  struct caller caller = {.address = (uintptr_t)address, .name = ""};
  dl_iterate_phdr(look, &caller);
  return caller;
}

/* A function of the calling library, in whatever scope it was loaded. */
static void *original_of(const struct caller *caller, const char *symbol)
{
  void *library = dlopen(caller->name, RTLD_NOW | RTLD_NOLOAD);
  void *found = library != NULL ? dlsym(library, symbol) : NULL;
  if (library != NULL)
    dlclose(library); /* it is loaded: it runs */
  return found;
}

/* ---- The adapter for that build */

/* The path of this library; NULL if it is relative, and so another one after chdir. */
static const char *own_path(void)
{
  Dl_info own;
  return dladdr((void *)refuse, &own) && own.dli_fname[0] == '/' ? own.dli_fname : NULL;
}

static void *opened(const char *id)
{
  char path[MAX_PATH];
  const char *own = own_path();
  if (own == NULL)
    return NULL;
  int folder = (int)(strrchr(own, '/') - own);
  int size = snprintf(path, sizeof path, "%.*s/pqsec-fastdds-%s.so", folder, own, id);
  return size < MAX_PATH ? dlopen(path, RTLD_NOW | RTLD_LOCAL) : NULL;
}

/* It is never closed: the stack may be anywhere in it. With `open` false, only one that a secured
 * participant has opened. */
static void *adapter_for(const char *id, bool open)
{
  static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
  static struct { char id[2 * MAX_ID + 1]; void *library; } known[MAX_ADAPTERS];
  void *found = NULL;
  pthread_mutex_lock(&mutex);
  for (int i = 0; i < MAX_ADAPTERS && found == NULL; i++) {
    if (known[i].library == NULL) {
      if (!open)
        break;
      found = known[i].library = opened(id);
      strcpy(known[i].id, id);
      break;
    }
    if (strcmp(known[i].id, id) == 0)
      found = known[i].library;
  }
  pthread_mutex_unlock(&mutex);
  return found;
}

static void *make(const struct plugin *plugin, const char *symbol, void *self, const void *policy,
                  const void *address)
{
  struct caller caller = caller_at(address);
  if (caller.id[0] == '\0')
    return refuse(plugin, "it has no build ID:", caller.name);
  if (own_path() == NULL)
    return refuse(plugin, "LD_PRELOAD must name pqsec's plugin by its absolute path, in",
                  caller.name);
  void *adapter = adapter_for(caller.id, true);
  if (adapter == NULL)
    return refuse(plugin, "pqsec's plugin was not compiled for this build of", caller.name);
  const char *id = dlsym(adapter, "pqsec_build_id");
  if (id == NULL || strcmp(id, caller.id) != 0)
    return refuse(plugin, "pqsec's plugin is for another build than", caller.name);
  factory original = (factory)original_of(&caller, symbol);
  maker make_ours = (maker)dlsym(adapter, plugin->maker);
  prober probe = (prober)dlsym(adapter, "pqsec_probe");
  if (original == NULL || make_ours == NULL || probe == NULL)
    return refuse(plugin, "pqsec's plugin is incomplete for", caller.name);
  if (!probe())
    return refuse(plugin, "pqsec's plugin does not find the topics of endpoints in", caller.name);
  return make_ours(policy, original, self);
}

#define DEFINE_FACTORY(name, space, which, plugin)                                       \
  EXPORT void *name(void *self, const void *policy) __asm__(FACTORY(space, which));      \
  void *name(void *self, const void *policy)                                             \
  {                                                                                      \
    return make(&plugin, FACTORY(space, which), self, policy, __builtin_return_address(0)); \
  }

DEFINE_FACTORY(authentication_2, IN_2, AUTHENTICATION, authentication)
DEFINE_FACTORY(access_control_2, IN_2, ACCESS_CONTROL, access_control)
DEFINE_FACTORY(authentication_3, IN_3, AUTHENTICATION, authentication)
DEFINE_FACTORY(access_control_3, IN_3, ACCESS_CONTROL, access_control)

/* ---- The size of handshake messages
 *
 * Fast DDS reserves as many bytes as a message has, and then writes it only if one more is left:
 * messages over 8192 bytes (2.14.4 to 3.2.2), or over the smallest transport's maxMessageSize
 * (2.9.1), are lost. So some more are reserved. The length of what is sent does not change. */

enum { SPARE = 8 };

static size_t sized(const char *symbol, const void *tokens, size_t alignment, const void *address)
{
  struct caller caller = caller_at(address);
  sizer original = (sizer)original_of(&caller, symbol);
  return (original != NULL ? original(tokens, alignment) : 0) + SPARE;
}

#define DEFINE_SIZE(name, space)                                                    \
  EXPORT size_t name(const void *tokens, size_t alignment) __asm__(SIZE(space));    \
  size_t name(const void *tokens, size_t alignment)                                 \
  {                                                                                 \
    return sized(SIZE(space), tokens, alignment, __builtin_return_address(0));      \
  }

DEFINE_SIZE(size_2, IN_2)
DEFINE_SIZE(size_3, IN_3)

/* ---- The endpoints of an authenticated peer
 *
 * Since the fix of CVE-2023-50257 (2.6.7, 2.10.3, 3.0), Fast DDS waits until an authenticated peer
 * announces itself again, on DCPSParticipantsSecure, and connects no endpoint before. Fast DDS 2.9
 * has no such topic, and Cyclone DDS never writes there: they would authenticate and never match.
 * So this library does at once what Fast DDS does at that announcement, with the announcement that
 * the handshake began with. Later ones on the topic without protection are still ignored. */

enum { GUID = 16 };

static void connected(const char *const names[4], void *self, const void *peer, bool secure,
                      const void *address)
{
  static const uint8_t nobody[GUID];
  struct caller caller = caller_at(address);
  connector original = (connector)original_of(&caller, names[0]);
  keeper keep = (keeper)original_of(&caller, names[1]);
  announcer announce = (announcer)original_of(&caller, names[2]);
  connector connect = (connector)original_of(&caller, names[3]);
  if (original != NULL)
    original(self, peer, secure);
  if (!secure || keep == NULL || announce == NULL || connect == NULL)
    return;
  void *kept = keep(self, peer, nobody);
  bool ignore = kept == NULL;
  if (kept != NULL)
    announce(self, kept, &ignore);
  if (!ignore)
    connect(self, peer, true);
}

#define DEFINE_NOTIFY(name, space)                                                              \
  EXPORT void name(void *self, const void *peer, bool secure) __asm__(NOTIFY(space));           \
  void name(void *self, const void *peer, bool secure)                                          \
  {                                                                                             \
    static const char *const names[] = {NOTIFY(space), KEEP(space), ANNOUNCE(space),            \
                                        CONNECT(space)};                                        \
    connected(names, self, peer, secure, __builtin_return_address(0));                          \
  }

DEFINE_NOTIFY(notify_2, IN_2)
DEFINE_NOTIFY(notify_3, IN_3)

/* ---- Peers that are revoked, or expire, in a session
 *
 * The adapter learns which object of discovery belongs to a participant while that object asks for
 * the identity token. When the participant announces itself again, the adapter is asked for peers
 * to drop. Nothing is fresh then: the caller is the thread of events, which drops silent peers too,
 * or the application; neither holds a lock. */

enum { DROPPED_PARTICIPANT = 3 };

struct dropping { remover remove; void *discovery; };

static void drop(void *context, const uint8_t *guid)
{
  const struct dropping *dropping = context;
  dropping->remove(dropping->discovery, guid, DROPPED_PARTICIPANT);
}

static void initialized(const char *name, void *self, void *data, const void *address)
{
  struct caller caller = caller_at(address);
  initializer original = (initializer)original_of(&caller, name);
  void *adapter = adapter_for(caller.id, false);
  maker_seen seen = adapter != NULL ? (maker_seen)dlsym(adapter, "pqsec_discovery") : NULL;
  if (seen != NULL)
    seen(self);
  if (original != NULL)
    original(self, data);
  if (seen != NULL)
    seen(NULL);
}

static void repeated(const char *const names[2], void *self, bool fresh, bool dispose,
                     void *parameters, const void *address)
{
  struct caller caller = caller_at(address);
  repeater original = (repeater)original_of(&caller, names[0]);
  struct dropping dropping = {(remover)original_of(&caller, names[1]), self};
  void *adapter = adapter_for(caller.id, false);
  loser lost = adapter != NULL ? (loser)dlsym(adapter, "pqsec_lost") : NULL;
  if (original != NULL)
    original(self, fresh, dispose, parameters);
  if (!fresh && !dispose && lost != NULL && dropping.remove != NULL)
    lost(self, drop, &dropping);
}

#define DEFINE_INITIALIZE(name, space)                                           \
  EXPORT void name(void *self, void *data) __asm__(INITIALIZE(space));           \
  void name(void *self, void *data)                                              \
  {                                                                              \
    initialized(INITIALIZE(space), self, data, __builtin_return_address(0));     \
  }

#define DEFINE_REPEAT(name, space, status)                                                     \
  EXPORT void name(void *self, bool fresh, bool dispose, void *parameters)                     \
      __asm__(REPEAT(space));                                                                  \
  void name(void *self, bool fresh, bool dispose, void *parameters)                            \
  {                                                                                            \
    static const char *const names[] = {REPEAT(space), REMOVE(space, status)};                 \
    repeated(names, self, fresh, dispose, parameters, __builtin_return_address(0));            \
  }

DEFINE_INITIALIZE(initialize_2, IN_2)
DEFINE_INITIALIZE(initialize_3, IN_3)
DEFINE_REPEAT(repeat_2, IN_2, STATUS_2)
DEFINE_REPEAT(repeat_3, IN_3, STATUS_3)
