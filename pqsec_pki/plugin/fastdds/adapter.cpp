// The adapter as one unit: most of the compiler's time goes to Fast DDS's headers.

#include "access_control.cpp"
#include "agent.cpp"
#include "authentication.cpp"
#include "probe.cpp"
#include "sessions.cpp"
