/* The controller of @NAME@, written by `unicon export`: C11, C++11; one in a process. Call
 * unicon_step every UNICON_PERIOD s and send what it gives. A result > 0 is a fault, and then each
 * output damps (stiffness falls to zero within UNICON_FADE s): go on for 0.5 s, then end.
 * UNICON_TICK_INPUT(DO) is DO(field) for each field of the input; the others likewise. */
#ifndef UNICON_CONTROLLER_H
#define UNICON_CONTROLLER_H

#include <stddef.h>
#include <stdint.h>

#define UNICON_PERIOD @PERIOD@
#define UNICON_FADE @BLEND@
#define UNICON_JOINT_NAMES {@JOINTS@}

#ifndef UNICON_PLACE
#if defined(__cplusplus)
#define UNICON_ASSERT(fact) static_assert(fact, #fact)
#else
#define UNICON_ASSERT(fact) _Static_assert(fact, #fact)
#endif
#define UNICON_PLACE(type, field, offset, size) \
    UNICON_ASSERT(offsetof(type, field) == offset && sizeof(((type *)0)->field) == size)
#endif
@STRUCTS@

#ifdef __cplusplus
extern "C" {
#endif

enum { UNICON_DONE = -1 };

/* Load ONNX Runtime and the networks of this folder; NULL, or what is wrong. */
const char *unicon_open(const char *library, const char *folder);
/* Its version, "" without networks. */
const char *unicon_onnxruntime(void);

/* Run a tick: 0, UNICON_DONE after the last one, or the number of the block that found a fault. */
int unicon_step(const struct unicon_tick_input *input, struct unicon_tick_output *output);
const char *unicon_block_name(int number);

/* Begin anew, after a fault too. */
void unicon_reset(void);
/* Copy what a tick leaves to the next one, unicon_size() bytes, within one process. */
size_t unicon_size(void);
void unicon_snapshot(void *memory);
void unicon_restore(const void *memory);

/* The states, for those that come from elsewhere, such as velocity_command. */
struct unicon_tick_states *unicon_states(void);

#ifdef __cplusplus
}
#endif
#endif
