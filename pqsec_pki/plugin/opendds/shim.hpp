// The C shim: its tables of functions, and what they are given and give.

#ifndef PQSEC_SHIM_HPP
#define PQSEC_SHIM_HPP

#include <cstdint>
#include <cstdlib>
#include <string>

namespace agent {
extern "C" {
#include "abi.h"
int init_authentication(const char* argument, void** context, void* domain);
int init_access_control(const char* argument, void** context, void* domain);
int finalize_authentication(void* context);
int finalize_access_control(void* context);
void free_token(struct token*);
}
}  // namespace agent

namespace pqsec {

// Why the shim said no.
class Reason {
 public:
  Reason() = default;
  ~Reason() { free(given_.message); }
  Reason(const Reason&) = delete;
  Reason& operator=(const Reason&) = delete;
  agent::exception* get() { return &given_; }
  std::string text() const { return given_.message != nullptr ? given_.message : "pqsec: refused"; }
  int32_t code() const { return given_.code; }

 private:
  agent::exception given_{};
};

// A function of a table, which gives `Result` and takes the table first and the exception last.
template <typename Signature>
struct Function;

template <typename Result, typename... Arguments>
struct Function<Result(Arguments...)> {
  template <typename Table>
  static Result call(Table* table, agent::function function, Reason& why, Arguments... arguments) {
    using Real = Result (*)(Table*, Arguments..., agent::exception*);
    return reinterpret_cast<Real>(function)(table, arguments..., why.get());
  }
};

}  // namespace pqsec

#endif
