/*
 * A coordinated participant of SIL Kit with steps of 1 ms, in which it sends a frame:
 *
 *     participant NAME IDENTIFIER STEPS RECORDING REGISTRY PARTICIPANT...
 *
 * IDENTIFIER 0 sends nothing. A RECORDING other than `-` gets a line for each frame that arrived. The first of the participants
 * says which take part, and ends all after STEPS. Prints how many frames arrived.
 *
 * The wheel of silkit-py has no C headers. These declarations are those of the C API of SIL Kit 5.0 that are used here.
 */
#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct { uint64_t version, reserved[3]; } header;
typedef struct { header header; uint32_t id, flags; uint16_t length_code; uint8_t sdt, vcid; uint32_t af; const uint8_t *data; size_t size; } can_frame;
typedef struct { header header; uint64_t time_ns; can_frame *frame; uint8_t direction; void *context; } can_event;
typedef struct { header header; int8_t mode; } lifecycle_configuration;
typedef struct { size_t count; char **names; } names;
typedef struct { header header; names *required; } workflow;
typedef void on_frame(void *context, void *controller, can_event *event);
typedef void on_ready(void *context, void *lifecycle);
typedef void on_step(void *context, void *time, uint64_t now_ns, uint64_t duration_ns);

int32_t     SilKit_ParticipantConfiguration_FromString(void **configuration, const char *text);
int32_t     SilKit_Participant_Create(void **participant, void *configuration, const char *name, const char *registry);
int32_t     SilKit_Participant_Destroy(void *participant);
int32_t     SilKit_Experimental_SystemController_Create(void **controller, void *participant);
int32_t     SilKit_Experimental_SystemController_SetWorkflowConfiguration(void *controller, const workflow *workflow);
int32_t     SilKit_LifecycleService_Create(void **lifecycle, void *participant, const lifecycle_configuration *configuration);
int32_t     SilKit_LifecycleService_SetCommunicationReadyHandler(void *lifecycle, void *context, on_ready *handler);
int32_t     SilKit_LifecycleService_StartLifecycle(void *lifecycle);
int32_t     SilKit_LifecycleService_Stop(void *lifecycle, const char *reason);
int32_t     SilKit_LifecycleService_WaitForLifecycleToComplete(void *lifecycle, int16_t *state);
int32_t     SilKit_TimeSyncService_Create(void **time, void *lifecycle);
int32_t     SilKit_TimeSyncService_SetSimulationStepHandler(void *time, void *context, on_step *handler, uint64_t step_ns);
int32_t     SilKit_CanController_Create(void **controller, void *participant, const char *name, const char *network);
int32_t     SilKit_CanController_Start(void *controller);
int32_t     SilKit_CanController_SendFrame(void *controller, can_frame *frame, void *context);
int32_t     SilKit_CanController_AddFrameHandler(void *controller, void *context, on_frame *handler, uint8_t directions, uint64_t *id);
const char *SilKit_GetLastErrorString(void);

/* The version of a struct: "SK", the service, the type in it, its version. */
#define VERSION(service, type, version) {UINT64_C(0x534B) << 48 | UINT64_C(service) << 40 | UINT64_C(type) << 32 | UINT64_C(version) << 24, {0}}
enum { COORDINATED = 10, RECEIVED = 2, SHUT_DOWN = 110, STEP_NS = 1000000 };

static void    *lifecycle, *can;
static uint32_t identifier;
static uint64_t steps, done, received;
static FILE    *recording;
static int      is_first;

static void check(int32_t code, const char *what) {
    if (!code) return;
    fprintf(stderr, "%s: %s\n", what, SilKit_GetLastErrorString());
    exit(1);
}

static void receive(void *context, void *controller, can_event *event) {
    (void)context, (void)controller;
    received++;
    if (recording) fprintf(recording, "%" PRIu64 " %03" PRIX32 "\n", event->time_ns, event->frame->id);
}

static void start(void *context, void *service) {
    (void)context, (void)service;
    check(SilKit_CanController_Start(can), "start of the controller");
}

static void step(void *context, void *time, uint64_t now_ns, uint64_t duration_ns) {
    (void)context, (void)time, (void)now_ns, (void)duration_ns;
    if (done == steps) return;
    uint8_t   data[8] = {(uint8_t)done, (uint8_t)(done >> 8)};
    can_frame frame = {.header = VERSION(1, 1, 1), .id = identifier, .length_code = sizeof data, .data = data, .size = sizeof data};
    if (identifier) check(SilKit_CanController_SendFrame(can, &frame, NULL), "sending");
    if (++done == steps && is_first) check(SilKit_LifecycleService_Stop(lifecycle, "done"), "stop");
}

int main(int count, char **words) {
    if (count < 7) return fprintf(stderr, "usage: participant NAME IDENTIFIER STEPS RECORDING REGISTRY PARTICIPANT...\n"), 2;
    const char *name = words[1];
    identifier = (uint32_t)strtoul(words[2], NULL, 0);
    steps = strtoull(words[3], NULL, 10);
    if (strcmp(words[4], "-") && !(recording = fopen(words[4], "w"))) return perror(words[4]), 1;
    names required = {(size_t)(count - 6), words + 6};
    is_first = !strcmp(name, required.names[0]);

    void   *configuration, *participant, *time, *controller;
    int16_t state;
    check(SilKit_ParticipantConfiguration_FromString(&configuration, "{\"Logging\": {\"Sinks\": []}}"), "configuration");
    check(SilKit_Participant_Create(&participant, configuration, name, words[5]), "participant");
    if (is_first) {
        workflow workflow = {VERSION(7, 3, 3), &required};
        check(SilKit_Experimental_SystemController_Create(&controller, participant), "system controller");
        check(SilKit_Experimental_SystemController_SetWorkflowConfiguration(controller, &workflow), "workflow");
    }
    lifecycle_configuration coordinated = {VERSION(7, 2, 1), COORDINATED};
    check(SilKit_LifecycleService_Create(&lifecycle, participant, &coordinated), "lifecycle");
    check(SilKit_TimeSyncService_Create(&time, lifecycle), "time");
    check(SilKit_CanController_Create(&can, participant, "CAN1", "CAN1"), "controller");
    uint64_t handler;
    check(SilKit_CanController_AddFrameHandler(can, NULL, receive, RECEIVED, &handler), "frame handler");
    check(SilKit_LifecycleService_SetCommunicationReadyHandler(lifecycle, NULL, start), "ready handler");
    check(SilKit_TimeSyncService_SetSimulationStepHandler(time, NULL, step, STEP_NS), "step handler");
    check(SilKit_LifecycleService_StartLifecycle(lifecycle), "start");
    check(SilKit_LifecycleService_WaitForLifecycleToComplete(lifecycle, &state), "end");
    check(SilKit_Participant_Destroy(participant), "leaving");
    if (recording && fclose(recording)) return perror(words[4]), 1;
    printf("%" PRIu64 "\n", received);
    return state == SHUT_DOWN ? 0 : 1;
}
