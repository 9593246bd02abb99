/* The octets between shim and agent: little-endian, strings and lists with a 32-bit count. */

#ifndef PQSEC_WIRE_H
#define PQSEC_WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "abi.h"

enum { MAX_FRAME = 1 << 20, MAX_ITEMS = 1024 };

/* What is written: grows as needed. `failed` stays once it is set. */
struct writer { uint8_t *data; size_t size, capacity; bool failed; };

/* What is read. `failed` stays once it is set, and all values are 0 from then on. */
struct reader { const uint8_t *data; size_t left; bool failed; };

void put_u8(struct writer *, uint8_t);
void put_u32(struct writer *, uint32_t);
void put_u64(struct writer *, uint64_t);
void put_raw(struct writer *, const void *, size_t);
void put_octets(struct writer *, const void *, size_t);
void put_string(struct writer *, const char *); /* NULL as "" */
void put_strings(struct writer *, const struct strings *);
void put_properties(struct writer *, const struct properties *);
void put_tags(struct writer *, const struct tags *);
void put_token(struct writer *, const struct token *); /* NULL as the token of class "" */
void forget(struct writer *);                          /* erases and frees */

uint8_t get_u8(struct reader *);
uint32_t get_u32(struct reader *);
uint64_t get_u64(struct reader *);
void get_raw(struct reader *, void *, size_t);
char *get_string(struct reader *);               /* malloc, or NULL */
void get_octets(struct reader *, struct octets *); /* malloc */
void get_token(struct reader *, struct token *);   /* whole, or all zero */

void free_token(struct token *); /* what it holds; leaves it all zero */

#endif
