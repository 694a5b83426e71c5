//! The functions of FMI 2.0 for co-simulation, by `fmi2Functions.h`, for libraries that [`crate::export!`] makes.
#![expect(unsafe_code, reason = "C calls these functions")]

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};

use super::played::{Failure, Played, guarded};

type Component = *mut c_void;
type Logger =
    unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);

/// `fmi2CallbackFunctions`; what follows the logger is not needed, but for the environment.
#[repr(C)]
pub(super) struct Callbacks {
    logger: Option<Logger>,
    _memory: [*const c_void; 3],
    environment: *mut c_void,
}

/// What a component points to.
struct Instance {
    played: Played,
    logger: Option<Logger>,
    environment: *mut c_void,
    name: std::ffi::CString,
}

const OK: c_int = 0;
const ERROR: c_int = 3;
/// `fmi2CoSimulation`.
const CO_SIMULATION: c_int = 1;

fn tell(logger: Option<Logger>, environment: *mut c_void, name: &CStr, failure: Failure) -> c_int {
    let status = failure.status();
    let words = failure.words();
    if let Some(logger) = logger {
        // SAFETY: the importer's logger, with a format and the text that it asks for.
        unsafe {
            logger(
                environment,
                name.as_ptr(),
                status,
                c"logStatusError".as_ptr(),
                c"%s".as_ptr(),
                words.as_ptr(),
            );
        }
    }
    status
}

/// # Safety
/// `component` is null, or what [`fmi2Instantiate`] returned and nothing freed.
unsafe fn on(component: Component, work: impl FnOnce(&mut Played) -> Result<(), String>) -> c_int {
    // SAFETY: by the caller.
    let Some(instance) = (unsafe { component.cast::<Instance>().as_mut() }) else {
        return ERROR;
    };
    match guarded(|| work(&mut instance.played)) {
        Ok(()) => OK,
        Err(failure) => {
            let (logger, environment) = (instance.logger, instance.environment);
            tell(logger, environment, &instance.name, failure)
        }
    }
}

/// # Safety
/// Null, or `count` values that live through the call.
unsafe fn slice<'a, T>(values: *const T, count: usize) -> &'a [T] {
    match values.is_null() {
        true => &[],
        // SAFETY: by the caller.
        false => unsafe { std::slice::from_raw_parts(values, count) },
    }
}

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
            return std::ptr::null_mut();
        }
        let token = CStr::from_ptr(token).to_string_lossy();
        (callbacks.as_ref(), CStr::from_ptr(name), token)
    };
    let logger = callbacks.and_then(|callbacks| callbacks.logger);
    let environment = callbacks.map_or(std::ptr::null_mut(), |callbacks| callbacks.environment);
    let made = guarded(|| match kind {
        CO_SIMULATION => Played::new(&token),
        _ => Err("this FMU is for co-simulation only".to_owned()),
    });
    match made {
        Ok(played) => Box::into_raw(Box::new(Instance {
            played,
            logger,
            environment,
            name: name.to_owned(),
        }))
        .cast(),
        Err(failure) => {
            tell(logger, environment, name, failure);
            std::ptr::null_mut()
        }
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2FreeInstance(component: Component) {
    if !component.is_null() {
        // SAFETY: what `fmi2Instantiate` returned, for the last time.
        drop(unsafe { Box::from_raw(component.cast::<Instance>()) });
    }
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
    unsafe {
        on(component, |played| {
            played.set_time(start_seconds);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2EnterInitializationMode(component: Component) -> c_int {
    // SAFETY: as above.
    unsafe { on(component, |_| Ok(())) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2ExitInitializationMode(component: Component) -> c_int {
    // SAFETY: as above.
    unsafe { on(component, Played::start) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2Terminate(component: Component) -> c_int {
    // SAFETY: as above.
    unsafe { on(component, |_| Ok(())) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2Reset(component: Component) -> c_int {
    // SAFETY: as above.
    unsafe { on(component, Played::reset) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2SetDebugLogging(
    component: Component,
    _is_on: c_int,
    _count: usize,
    _categories: *const *const c_char,
) -> c_int {
    // SAFETY: as above.
    unsafe { on(component, |_| Ok(())) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2GetReal(
    component: Component,
    references: *const c_uint,
    count: usize,
    values: *mut f64,
) -> c_int {
    // SAFETY: as above, with as many references as room for values.
    unsafe {
        on(component, |played| {
            for (place, reference) in slice(references, count).iter().enumerate() {
                *values.add(place) = played.number(*reference)?;
            }
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2SetReal(
    component: Component,
    references: *const c_uint,
    count: usize,
    values: *const f64,
) -> c_int {
    // SAFETY: as above, with as many references as values.
    unsafe {
        let pairs = slice(references, count).iter().zip(slice(values, count));
        on(component, |played| {
            { pairs }.try_for_each(|(reference, value)| played.set_number(*reference, *value))
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2GetString(
    component: Component,
    references: *const c_uint,
    count: usize,
    values: *mut *const c_char,
) -> c_int {
    // SAFETY: as above, with as many references as room for values.
    unsafe {
        on(component, |played| {
            for (place, reference) in slice(references, count).iter().enumerate() {
                *values.add(place) = played.word(*reference)?.as_ptr();
            }
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2SetString(
    component: Component,
    references: *const c_uint,
    count: usize,
    values: *const *const c_char,
) -> c_int {
    // SAFETY: as above, with as many references as values, each a C string.
    unsafe {
        let pairs = slice(references, count).iter().zip(slice(values, count));
        on(component, |played| {
            { pairs }.try_for_each(|(reference, value)| {
                played.set_word(*reference, CStr::from_ptr(*value))
            })
        })
    }
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

/// Functions of what the FMUs do not have: whole numbers, truths, saved states, derivatives, steps in the background. They only
/// refuse; what else they are called with stays where C put it.
macro_rules! not_served {
    ($($name:ident)+) => {
        $(
            #[unsafe(no_mangle)]
            pub(super) extern "C" fn $name(_component: Component) -> c_int {
                ERROR
            }
        )+
    };
}

not_served! {
    fmi2GetFMUstate fmi2SetFMUstate fmi2FreeFMUstate fmi2SerializedFMUstateSize fmi2SerializeFMUstate
    fmi2DeSerializeFMUstate fmi2GetDirectionalDerivative fmi2SetRealInputDerivatives fmi2GetRealOutputDerivatives
    fmi2CancelStep fmi2GetStatus fmi2GetRealStatus fmi2GetIntegerStatus fmi2GetBooleanStatus fmi2GetStringStatus
}

/// Values of a type that no variable has: none of them can be got or set, and nothing is asked of none.
macro_rules! of_no_variable {
    ($($name:ident)+) => {
        $(
            #[unsafe(no_mangle)]
            pub(super) extern "C" fn $name(
                _component: Component,
                _references: *const c_uint,
                count: usize,
                _values: *mut c_int,
            ) -> c_int {
                if count == 0 { OK } else { ERROR }
            }
        )+
    };
}

of_no_variable! { fmi2GetInteger fmi2SetInteger fmi2GetBoolean fmi2SetBoolean }
