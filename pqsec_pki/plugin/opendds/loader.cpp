// How the plugins get into OpenDDS. A program asks for PqsecLoader by a directive; an unmodified one
// finds this library by the name of OpenDDS's own, and asks for BuiltInPluginLoader. Both load
// OpenDDS's own first, whose crypto plugins go on encrypting, and then take its place.
//
// PQSEC_BUILTIN is the path of libOpenDDS_Security.so, PQSEC_BUILTIN_SIZE and _TIME its size and
// the second of its last change at installation: the adapter fits no other build.

#include <ace/Service_Object.h>
#include <dlfcn.h>
#include <sys/stat.h>

#include <cstdio>

#include "stack.hpp"

namespace pqsec {
namespace {

using OpenDDS::Security::SecurityConfig_rch;
using OpenDDS::Security::SecurityRegistry;

constexpr char NAME[] = "pqsec";

// OpenDDS's own for encryption, ours for the rest.
class Plugins : public WithUtility<SecurityConfig_rch> {
 public:
  Plugins(const SecurityConfig_rch& builtin, security::Authentication* authentication,
          security::AccessControl* access_control)
      : WithUtility<SecurityConfig_rch>(builtin),
        builtin_(builtin),
        authentication_(authentication),
        access_control_(access_control) {}

  security::Authentication_var create_authentication() override { return authentication_; }
  security::AccessControl_var create_access_control() override { return access_control_; }
  security::CryptoKeyExchange_var create_crypto_key_exchange() override {
    return builtin_->get_crypto_key_exchange();
  }
  security::CryptoKeyFactory_var create_crypto_key_factory() override {
    return builtin_->get_crypto_key_factory();
  }
  security::CryptoTransform_var create_crypto_transform() override {
    return builtin_->get_crypto_transform();
  }
  void shutdown() override {}

 private:
  SecurityConfig_rch builtin_;
  security::Authentication_var authentication_;
  security::AccessControl_var access_control_;
};

int failed(const char* why) {
  fprintf(stderr, "pqsec: %s\n", why);
  return -1;
}

bool is_same_build() {
  struct stat found;
  return stat(PQSEC_BUILTIN, &found) == 0 && found.st_size == PQSEC_BUILTIN_SIZE &&
         found.st_mtim.tv_sec == PQSEC_BUILTIN_TIME;
}

// OpenDDS's own plugins, by path: their name may be ours.
int load_builtin() {
  void* const library = dlopen(PQSEC_BUILTIN, RTLD_NOW | RTLD_GLOBAL);
  if (library == nullptr) return failed(dlerror());
  using Make = ACE_Service_Object* (*)(ACE_Service_Object_Exterminator*);
  const auto make = reinterpret_cast<Make>(dlsym(library, "_make_BuiltInPluginLoader"));
  if (make == nullptr) return failed("OpenDDS's own security plugins are not in " PQSEC_BUILTIN);
  ACE_Service_Object_Exterminator destroy = nullptr;
  static ACE_Service_Object* const loader = make(&destroy);  // stays as long as its library
  return loader != nullptr ? loader->init(0, nullptr) : -1;
}

int load() {
  if (!is_same_build())
    return failed(PQSEC_BUILTIN " was changed since: run `pqsec plugin install opendds` again");
  const auto known = std::make_shared<Known>();
  security::Authentication* const authentication = make_authentication(known);
  security::AccessControl* const access_control = make_access_control(known);
  if (authentication == nullptr || access_control == nullptr) return failed("out of memory");
  if (load_builtin() != 0) return -1;
  SecurityRegistry* const registry = SecurityRegistry::instance();
  const SecurityConfig_rch builtin = registry->get_config(SecurityRegistry::DEFAULT_CONFIG_NAME);
  if (!builtin) return failed("OpenDDS's own security plugins did not register");
  const OpenDDS::Security::SecurityPluginInst_rch plugins =
      OpenDDS::DCPS::make_rch<Plugins>(builtin, authentication, access_control);
  registry->register_plugin(NAME, plugins);
  // Binding one participant would not do: discovery and transport take the default.
  registry->default_config(registry->create_config(NAME, plugins));
  return 0;
}

class Loader : public ACE_Service_Object {
 public:
  int init(int, ACE_TCHAR**) override {
    static const int result = load();
    return result;
  }
};

void destroy(void* loader) { delete static_cast<Loader*>(loader); }

ACE_Service_Object* make(ACE_Service_Object_Exterminator* exterminator) {
  if (exterminator != nullptr) *exterminator = destroy;
  return new Loader;
}

}  // namespace
}  // namespace pqsec

// The names by which ACE finds them.
extern "C" __attribute__((visibility("default"))) ACE_Service_Object* _make_PqsecLoader(
    ACE_Service_Object_Exterminator* exterminator) {
  return pqsec::make(exterminator);
}

extern "C" __attribute__((visibility("default"))) ACE_Service_Object* _make_BuiltInPluginLoader(
    ACE_Service_Object_Exterminator* exterminator) {
  return pqsec::make(exterminator);
}
