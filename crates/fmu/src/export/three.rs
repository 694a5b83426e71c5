//! The functions of FMI 3.0 for co-simulation, by `fmi3Functions.h`, for libraries that [`crate::export!`] makes.
#![expect(unsafe_code, reason = "C calls these functions")]

use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr::null_mut;

use super::component::{
    Component, ERROR, OK, free, get, getters, made, not_served, of_no_variable, on, on_instance,
    set, setters, text,
};
use super::played::Played;

type LogMessage = unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char);

#[unsafe(no_mangle)]
pub(super) extern "C" fn fmi3GetVersion() -> *const c_char {
    c"3.0".as_ptr()
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3InstantiateCoSimulation(
    _name: *const c_char,
    token: *const c_char,
    _resources: *const c_char,
    _visible: bool,
    _logging: bool,
    _events: bool,
    _early: bool,
    _intermediate: *const u32,
    _count: usize,
    environment: *mut c_void,
    log: Option<LogMessage>,
    _update: *const c_void,
) -> Component {
    if token.is_null() {
        return null_mut();
    }
    // SAFETY: a text of the importer, by FMI.
    let token = unsafe { CStr::from_ptr(token) }.to_string_lossy();
    let tell = move |status, message: &CStr| {
        if let Some(log) = log {
            // SAFETY: the importer's function, with C strings.
            unsafe {
                log(
                    environment,
                    status,
                    c"logStatusError".as_ptr(),
                    message.as_ptr(),
                )
            };
        }
    };
    made(|| Played::new(&token), Box::new(tell))
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3FreeInstance(component: Component) {
    // SAFETY: `fmi3InstantiateCoSimulation` returned the pointer, and this is its last use.
    unsafe { free(component) };
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3EnterInitializationMode(
    component: Component,
    _has_tolerance: bool,
    _tolerance: f64,
    start_seconds: f64,
    _has_stop: bool,
    _stop_seconds: f64,
) -> c_int {
    // SAFETY: a component, by FMI, as in all functions below.
    unsafe { on(component, |played| played.set_time(start_seconds)) }
}

on_instance! {
    fmi3ExitInitializationMode: Played::start;
    fmi3Terminate: |_| Ok(());
    fmi3Reset: Played::reset;
    fmi3SetDebugLogging: |_| Ok(());
}

getters! {
    fmi3GetFloat64(f64): Played::number;
    fmi3GetString(*const c_char): text;
}

setters! {
    fmi3SetFloat64(f64): Played::set_number;
    fmi3SetString(*const c_char): |played, reference, word| played.set_word(reference, CStr::from_ptr(word));
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3DoStep(
    component: Component,
    from_seconds: f64,
    duration_seconds: f64,
    _no_set: bool,
    needs_events: *mut bool,
    is_terminated: *mut bool,
    returned_early: *mut bool,
    last_seconds: *mut f64,
) -> c_int {
    // SAFETY: as above, with room for each value or none.
    unsafe {
        for truth in [needs_events, is_terminated, returned_early] {
            if !truth.is_null() {
                *truth = false;
            }
        }
        let status = on(component, |played| {
            played.step(from_seconds, duration_seconds)
        });
        if !last_seconds.is_null() {
            let passed = if status == OK { duration_seconds } else { 0.0 };
            *last_seconds = from_seconds + passed;
        }
        status
    }
}

// Features that are not supported: other interfaces, events, clocks, saved states, derivatives, arrays.
not_served! {
    fmi3EnterEventMode fmi3EnterStepMode fmi3UpdateDiscreteStates fmi3EvaluateDiscreteStates fmi3EnterConfigurationMode
    fmi3ExitConfigurationMode fmi3GetNumberOfVariableDependencies fmi3GetVariableDependencies fmi3GetFMUState
    fmi3SetFMUState fmi3FreeFMUState fmi3SerializedFMUStateSize fmi3SerializeFMUState fmi3DeserializeFMUState
    fmi3GetDirectionalDerivative fmi3GetAdjointDerivative fmi3GetIntervalDecimal fmi3GetIntervalFraction
    fmi3GetShiftDecimal fmi3GetShiftFraction fmi3SetIntervalDecimal fmi3SetIntervalFraction fmi3SetShiftDecimal
    fmi3SetShiftFraction fmi3EnterContinuousTimeMode fmi3CompletedIntegratorStep fmi3SetTime fmi3SetContinuousStates
    fmi3GetContinuousStateDerivatives fmi3GetEventIndicators fmi3GetContinuousStates fmi3GetNominalsOfContinuousStates
    fmi3GetNumberOfEventIndicators fmi3GetNumberOfContinuousStates fmi3GetOutputDerivatives fmi3ActivateModelPartition
}

/// Defines the functions of other interfaces, which make no instance.
macro_rules! no_instance {
    ($($name:ident)+) => {
        $(
            #[unsafe(no_mangle)]
            pub(super) extern "C" fn $name(_name: *const c_char) -> Component {
                null_mut()
            }
        )+
    };
}

no_instance! { fmi3InstantiateModelExchange fmi3InstantiateScheduledExecution }

of_no_variable! {
    fmi3GetFloat32 fmi3GetInt8 fmi3GetUInt8 fmi3GetInt16 fmi3GetUInt16 fmi3GetInt32 fmi3GetUInt32 fmi3GetInt64 fmi3GetUInt64
    fmi3GetBoolean fmi3GetBinary fmi3GetClock fmi3SetFloat32 fmi3SetInt8 fmi3SetUInt8 fmi3SetInt16 fmi3SetUInt16 fmi3SetInt32
    fmi3SetUInt32 fmi3SetInt64 fmi3SetUInt64 fmi3SetBoolean fmi3SetBinary fmi3SetClock
}
