/* `pqsec plugin install fastdds` runs this with the adapter that it compiled; see probe.cpp. */

#include <stdbool.h>
#include <stdio.h>

bool pqsec_probe(void);

int main(void)
{
  if (pqsec_probe())
    return 0;
  fprintf(stderr, "topic and partitions of an endpoint are not where they were expected\n");
  return 1;
}
