/* A firmware that sends more than there is room for, and takes no frame. */
#include "canrig_native_sim.h"
#include "processor.h"

#include <stdio.h>

int firmware_main(void) {
    const canrig_native_sim_frame frame = {0x123, 8, {0}}, too_high = {0x800, 0, {0}}, too_long = {0x123, 9, {0}};
    int                           queued = 0;
    if (canrig_native_sim_send(&too_high) != -1 || canrig_native_sim_send(&too_long) != -1) return 1;
    while (canrig_native_sim_send(&frame) == 0) queued++;
    fprintf(stderr, "%d frames queued\n", queued);
    for (;;) processor_halt();
}
