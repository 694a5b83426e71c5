/* Lets Debian's user-mode Linux run on processors with AMX: tests/vcan/with_can preloads it there.
 *
 * That kernel keeps the registers of its processes in as many bytes as AVX-512 needs. The kernel below it takes registers
 * only as a whole, so what lies behind is filled up with zeros: registers that nobody uses. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

/* More than any processor's registers. */
static char whole[1 << 16];
static size_t whole_bytes;

long ptrace(enum __ptrace_request request, ...)
{
    static long (*next)(enum __ptrace_request, ...);
    if (!next)
        next = (long (*)(enum __ptrace_request, ...))dlsym(RTLD_NEXT, "ptrace");

    va_list arguments;
    va_start(arguments, request);
    pid_t process = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if (request != PTRACE_SETREGSET || address != (void *)NT_X86_XSTATE)
        return next(request, process, address, data);
    if (!whole_bytes) {
        struct iovec present = { whole, sizeof whole };
        long read = next(PTRACE_GETREGSET, process, address, &present);
        if (read < 0)
            return read;
        whole_bytes = present.iov_len;
        memset(whole, 0, sizeof whole);
    }
    const struct iovec *kept = data;
    if (kept->iov_len >= whole_bytes)
        return next(request, process, address, data);
    memcpy(whole, kept->iov_base, kept->iov_len);
    struct iovec filled_up = { whole, whole_bytes };
    return next(request, process, address, &filled_up);
}
