/* Encodes values, and decodes octets of another process, which are not trusted. */

#define _GNU_SOURCE
#include "wire.h"

#include <stdlib.h>
#include <string.h>

static uint8_t *room(struct writer *w, size_t more)
{
  if (w->failed || more > MAX_FRAME || w->size + more > MAX_FRAME) {
    w->failed = true;
    return NULL;
  }
  if (w->size + more > w->capacity) {
    size_t capacity = 2 * (w->size + more);
    uint8_t *data = malloc(capacity);
    if (data == NULL) {
      w->failed = true;
      return NULL;
    }
    if (w->size > 0)
      memcpy(data, w->data, w->size);
    size_t size = w->size;
    forget(w); /* it may contain secrets */
    *w = (struct writer){.data = data, .size = size, .capacity = capacity};
  }
  w->size += more;
  return w->data + w->size - more;
}

void forget(struct writer *w)
{
  if (w->data != NULL)
    explicit_bzero(w->data, w->capacity);
  free(w->data);
  *w = (struct writer){.failed = w->failed};
}

void put_raw(struct writer *w, const void *data, size_t size)
{
  uint8_t *at = size > 0 ? room(w, size) : NULL;
  if (at != NULL)
    memcpy(at, data, size);
}

void put_u64(struct writer *w, uint64_t value)
{
  uint8_t octets[8];
  for (int i = 0; i < 8; i++)
    octets[i] = (uint8_t)(value >> 8 * i);
  put_raw(w, octets, 8);
}

void put_u32(struct writer *w, uint32_t value)
{
  const uint8_t octets[] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16),
                            (uint8_t)(value >> 24)};
  put_raw(w, octets, 4);
}

void put_u8(struct writer *w, uint8_t value) { put_raw(w, &value, 1); }

void put_octets(struct writer *w, const void *data, size_t size)
{
  if (size > MAX_FRAME)
    w->failed = true;
  put_u32(w, (uint32_t)size);
  put_raw(w, data, size);
}

void put_string(struct writer *w, const char *text)
{
  put_octets(w, text, text != NULL ? strlen(text) : 0);
}

void put_strings(struct writer *w, const struct strings *list)
{
  uint32_t count = list != NULL ? list->length : 0;
  put_u32(w, count);
  for (uint32_t i = 0; i < count && !w->failed; i++)
    put_string(w, list->buffer[i]);
}

void put_properties(struct writer *w, const struct properties *list)
{
  put_u32(w, list->length);
  for (uint32_t i = 0; i < list->length && !w->failed; i++) {
    put_string(w, list->buffer[i].name);
    put_string(w, list->buffer[i].value);
  }
}

void put_tags(struct writer *w, const struct tags *list)
{
  uint32_t count = list != NULL ? list->length : 0;
  put_u32(w, count);
  for (uint32_t i = 0; i < count && !w->failed; i++) {
    put_string(w, list->buffer[i].name);
    put_string(w, list->buffer[i].value);
  }
}

void put_token(struct writer *w, const struct token *token)
{
  static const struct token none = {0};
  token = token != NULL ? token : &none;
  put_string(w, token->class_id);
  put_properties(w, &token->properties);
  put_u32(w, token->binary.length);
  for (uint32_t i = 0; i < token->binary.length && !w->failed; i++) {
    const struct binary_property *each = &token->binary.buffer[i];
    put_string(w, each->name);
    put_octets(w, each->value.buffer, each->value.length);
  }
}

static const uint8_t *take(struct reader *r, size_t size)
{
  if (r->failed || size > r->left) {
    r->failed = true;
    return NULL;
  }
  r->data += size;
  r->left -= size;
  return r->data - size;
}

void get_raw(struct reader *r, void *into, size_t size)
{
  const uint8_t *data = take(r, size);
  if (data == NULL)
    memset(into, 0, size);
  else
    memcpy(into, data, size);
}

uint64_t get_u64(struct reader *r)
{
  uint8_t octets[8];
  uint64_t value = 0;
  get_raw(r, octets, 8);
  for (int i = 8; i-- > 0;)
    value = value << 8 | octets[i];
  return value;
}

uint32_t get_u32(struct reader *r)
{
  uint8_t octets[4];
  get_raw(r, octets, 4);
  return octets[0] | (uint32_t)octets[1] << 8 | (uint32_t)octets[2] << 16 |
         (uint32_t)octets[3] << 24;
}

uint8_t get_u8(struct reader *r)
{
  uint8_t value;
  get_raw(r, &value, 1);
  return value;
}

/* A copy with a NUL behind it, so that it may be a string too. */
static uint8_t *get_block(struct reader *r, uint32_t *size)
{
  *size = get_u32(r);
  const uint8_t *data = take(r, *size);
  uint8_t *copy = data != NULL ? malloc((size_t)*size + 1) : NULL;
  if (copy == NULL) {
    r->failed = true;
    *size = 0;
    return NULL;
  }
  memcpy(copy, data, *size);
  copy[*size] = 0;
  return copy;
}

char *get_string(struct reader *r)
{
  uint32_t size;
  return (char *)get_block(r, &size);
}

void get_octets(struct reader *r, struct octets *octets)
{
  uint32_t size;
  octets->buffer = get_block(r, &size);
  octets->length = octets->maximum = size;
}

/* An array of zeros for as many items as the octets say. */
static void *get_items(struct reader *r, uint32_t *count, size_t size)
{
  *count = get_u32(r);
  if (*count > MAX_ITEMS)
    r->failed = true;
  void *items = !r->failed && *count > 0 ? calloc(*count, size) : NULL;
  if (items == NULL) {
    r->failed = r->failed || *count > 0;
    *count = 0;
  }
  return items;
}

void get_token(struct reader *r, struct token *token)
{
  uint32_t count;
  *token = (struct token){.class_id = get_string(r)};
  token->properties.buffer = get_items(r, &count, sizeof(struct property));
  token->properties.maximum = token->properties.length = count;
  for (uint32_t i = 0; i < count; i++) {
    struct property *each = &token->properties.buffer[i];
    each->name = get_string(r);
    each->value = get_string(r);
    each->propagate = 1;
  }
  token->binary.buffer = get_items(r, &count, sizeof(struct binary_property));
  token->binary.maximum = token->binary.length = count;
  for (uint32_t i = 0; i < count; i++) {
    struct binary_property *each = &token->binary.buffer[i];
    each->name = get_string(r);
    get_octets(r, &each->value);
    each->propagate = 1;
  }
  if (r->failed)
    free_token(token);
}

void free_token(struct token *token)
{
  for (uint32_t i = 0; i < token->properties.length; i++) {
    free(token->properties.buffer[i].name);
    free(token->properties.buffer[i].value);
  }
  for (uint32_t i = 0; i < token->binary.length; i++) {
    free(token->binary.buffer[i].name);
    free(token->binary.buffer[i].value.buffer);
  }
  free(token->properties.buffer);
  free(token->binary.buffer);
  free(token->class_id);
  *token = (struct token){0};
}
