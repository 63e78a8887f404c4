/* The controller of @NAME@, written by `unicon export`. Call unicon_step every @PERIOD@ s.
 *
 *     const char *wrong = unicon_open("/path/to/libonnxruntime.so", "/path/to/this/folder");
 *     for (;;) {
 *         read the robot into `input`;
 *         result = unicon_step(&input, &output);
 *         send `output` to the robot;
 *         if (result == UNICON_DONE) break;
 *         if (result > 0 && ++damped > 0.5 s) break;   // a fault: it damps from here on
 *     }
 *
 * A result > 0 is the number of the block that found a fault; nothing more is computed until
 * unicon_reset. Go on with the calls and send the outputs, which damp: stiffness falls to zero
 * within @BLEND@ s. Whoever stops calling, or ends, leaves the robot to its own command timeout.
 *
 * C11 or C++11. There is one controller in a process, for one thread.
 */
#ifndef UNICON_CONTROLLER_H
#define UNICON_CONTROLLER_H

#include <stddef.h>
#include <stdint.h>

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

/* Load ONNX Runtime and the networks of a folder; return NULL, or what is wrong. Resets. */
const char *unicon_open(const char *library, const char *folder);

/* Return the version of the ONNX Runtime that is loaded, "" for none. */
const char *unicon_onnxruntime(void);

/* Run a tick; return 0, UNICON_DONE after the last one, or the number of a block with a fault. */
int unicon_step(const struct unicon_tick_input *input, struct unicon_tick_output *output);

/* Return the name of a block by its number, "" for others. */
const char *unicon_block_name(int number);

/* Begin anew; a fault is forgotten. */
void unicon_reset(void);

/* Copy all that a tick leaves to the next one, unicon_size() bytes: out, and in again. */
size_t unicon_size(void);
void unicon_snapshot(void *memory);
void unicon_restore(const void *memory);

/* Return the states, which the next tick continues with. */
struct unicon_tick_states *unicon_states(void);

#ifdef __cplusplus
}
#endif
#endif
