//! The functions of FMI 2.0 for co-simulation, by `fmi2Functions.h`, for libraries that [`crate::export!`] makes.
#![expect(unsafe_code, reason = "C calls these functions")]

use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr::null_mut;

use super::component::{
    Component, ERROR, OK, free, get, getters, made, not_served, of_no_variable, on, on_instance,
    set, setters, text,
};
use super::played::Played;

type Logger =
    unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);

/// `fmi2CallbackFunctions`. Of the fields after the logger only the environment is used.
#[repr(C)]
pub(super) struct Callbacks {
    logger: Option<Logger>,
    _memory: [*const c_void; 3],
    environment: *mut c_void,
}

/// `fmi2CoSimulation`.
const CO_SIMULATION: c_int = 1;

#[unsafe(no_mangle)]
pub(super) extern "C" fn fmi2GetTypesPlatform() -> *const c_char {
    c"default".as_ptr()
}

#[unsafe(no_mangle)]
pub(super) extern "C" fn fmi2GetVersion() -> *const c_char {
    c"2.0".as_ptr()
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2Instantiate(
    name: *const c_char,
    kind: c_int,
    token: *const c_char,
    _resources: *const c_char,
    callbacks: *const Callbacks,
    _visible: c_int,
    _logging: c_int,
) -> Component {
    // SAFETY: texts and callbacks of the importer, by FMI.
    let (callbacks, name, token) = unsafe {
        if name.is_null() || token.is_null() {
            return null_mut();
        }
        let token = CStr::from_ptr(token).to_string_lossy();
        (callbacks.as_ref(), CStr::from_ptr(name).to_owned(), token)
    };
    let logger = callbacks.and_then(|callbacks| callbacks.logger);
    let environment = callbacks.map_or(null_mut(), |callbacks| callbacks.environment);
    let tell = move |status, message: &CStr| {
        if let Some(logger) = logger {
            let (name, category, format) =
                (name.as_ptr(), c"logStatusError".as_ptr(), c"%s".as_ptr());
            // SAFETY: the importer's logger, with a format and the text that it asks for.
            unsafe {
                logger(
                    environment,
                    name,
                    status,
                    category,
                    format,
                    message.as_ptr(),
                )
            };
        }
    };
    let make = || match kind {
        CO_SIMULATION => Played::new(&token),
        _ => Err("this FMU is for co-simulation only".to_owned()),
    };
    made(make, Box::new(tell))
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2FreeInstance(component: Component) {
    // SAFETY: `fmi2Instantiate` returned the pointer, and this is its last use.
    unsafe { free(component) };
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2SetupExperiment(
    component: Component,
    _has_tolerance: c_int,
    _tolerance: f64,
    start_seconds: f64,
    _has_stop: c_int,
    _stop_seconds: f64,
) -> c_int {
    // SAFETY: a component, by FMI, as in all functions below.
    unsafe { on(component, |played| played.set_time(start_seconds)) }
}

on_instance! {
    fmi2EnterInitializationMode: |_| Ok(());
    fmi2ExitInitializationMode: Played::start;
    fmi2Terminate: |_| Ok(());
    fmi2Reset: Played::reset;
    fmi2SetDebugLogging: |_| Ok(());
}

getters! {
    fmi2GetReal(f64): Played::number;
    fmi2GetString(*const c_char): text;
}

setters! {
    fmi2SetReal(f64): Played::set_number;
    fmi2SetString(*const c_char): |played, reference, word| played.set_word(reference, CStr::from_ptr(word));
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2DoStep(
    component: Component,
    from_seconds: f64,
    duration_seconds: f64,
    _no_set: c_int,
) -> c_int {
    // SAFETY: as above.
    unsafe {
        on(component, |played| {
            played.step(from_seconds, duration_seconds)
        })
    }
}

// Features that are not supported: saved states, derivatives, steps in the background.
not_served! {
    fmi2GetFMUstate fmi2SetFMUstate fmi2FreeFMUstate fmi2SerializedFMUstateSize fmi2SerializeFMUstate
    fmi2DeSerializeFMUstate fmi2GetDirectionalDerivative fmi2SetRealInputDerivatives fmi2GetRealOutputDerivatives
    fmi2CancelStep fmi2GetStatus fmi2GetRealStatus fmi2GetIntegerStatus fmi2GetBooleanStatus fmi2GetStringStatus
}

of_no_variable! { fmi2GetInteger fmi2SetInteger fmi2GetBoolean fmi2SetBoolean }
