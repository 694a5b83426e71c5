//! The functions of FMI 2.0 for co-simulation, by `fmi2FunctionTypes.h`.

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};

use libloading::os::unix::Library;

use super::loaded::{Component, Family, Loaded, Numbers, OwnFunctions, Plain, Step};
use super::log::Log;
use super::{Status, Stepped, function, whole};
use crate::description::Kind;
use crate::error::Fault;

type Get<T> = unsafe extern "C" fn(Component, *const c_uint, usize, *mut T) -> c_int;
type Set<T> = unsafe extern "C" fn(Component, *const c_uint, usize, *const T) -> c_int;
type Instantiate = unsafe extern "C" fn(
    *const c_char,
    c_int,
    *const c_char,
    *const c_char,
    *const Callbacks,
    c_int,
    c_int,
) -> Component;
type SetupExperiment = unsafe extern "C" fn(Component, c_int, f64, f64, c_int, f64) -> c_int;
type DoStep = unsafe extern "C" fn(Component, f64, f64, c_int) -> c_int;
type GetStatus<T> = unsafe extern "C" fn(Component, c_int, *mut T) -> c_int;

/// Name of the function that makes an instance.
const INSTANTIATE: &str = "fmi2Instantiate";
/// `fmi2CoSimulation`.
const CO_SIMULATION: c_int = 1;
/// `fmi2LastSuccessfulTime`.
const LAST_SUCCESSFUL_TIME: c_int = 2;
/// `fmi2Terminated`.
const TERMINATED: c_int = 3;

/// `fmi2CallbackFunctions`.
#[repr(C)]
struct Callbacks {
    /// The function in C is variadic. On all supported platforms the arguments that FMI names are passed as to a
    /// function with just these.
    logger: unsafe extern "C" fn(
        *mut c_void,
        *const c_char,
        c_int,
        *const c_char,
        *const c_char,
        *const c_char,
    ),
    allocate: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free: unsafe extern "C" fn(*mut c_void),
    step_finished: Option<unsafe extern "C" fn(*mut c_void, c_int)>,
    environment: *const c_void,
}

unsafe extern "C" fn allocate(count: usize, size: usize) -> *mut c_void {
    // SAFETY: any count and size.
    unsafe { libc::calloc(count, size) }
}

unsafe extern "C" fn free(memory: *mut c_void) {
    // SAFETY: `allocate` returned the memory, by FMI.
    unsafe { libc::free(memory) }
}

/// Keeps the format of a message, or the text of a message with the format `%s`.
unsafe extern "C" fn logger(
    environment: *mut c_void,
    _instance: *const c_char,
    _status: c_int,
    _category: *const c_char,
    message: *const c_char,
    first: *const c_char,
) {
    if environment.is_null() || message.is_null() {
        return;
    }
    // SAFETY: the environment is the instance's log, which lives longer than the instance; the message is a C string, and
    // with the format `%s` so is what follows it.
    unsafe {
        let log = &*environment.cast::<Log>();
        let is_text = CStr::from_ptr(message) == c"%s";
        log.keep(if is_text { first } else { message });
    }
}

/// Functions of FMI 2.0.
struct Two;

impl Family for Two {
    const PREFIX: &'static str = "fmi2";
    type Get<T: 'static> = Get<T>;
    type Set<T: 'static> = Set<T>;

    unsafe fn get<T>(get: Get<T>, of: Component, reference: u32, value: &mut T) -> c_int {
        // SAFETY: by the caller, with one reference and room for one value.
        unsafe { get(of, &raw const reference, 1, value) }
    }

    unsafe fn set<T>(set: Set<T>, of: Component, reference: u32, value: &T) -> c_int {
        // SAFETY: by the caller, with one reference and one value.
        unsafe { set(of, &raw const reference, 1, value) }
    }
}

/// Makes an instance in a library.
pub(super) fn instance(
    library: Library,
    name: &CStr,
    token: &CStr,
    resources: &CStr,
) -> Result<Loaded, Fault> {
    // SAFETY: the types are those of FMI 2.0, and the library lives as long as the instance, as callbacks and log do. All texts
    // live through the call.
    unsafe {
        function::<Get<f64>>(&library, "fmi2GetReal")?;
        function::<Set<f64>>(&library, "fmi2SetReal")?;
        let setup: SetupExperiment = function(&library, "fmi2SetupExperiment")?;
        let enter: Plain = function(&library, "fmi2EnterInitializationMode")?;
        let enter_initialization = move |of, start_seconds, tolerance: Option<f64>| {
            let (is_defined, tolerance) = (tolerance.is_some(), tolerance.unwrap_or_default());
            let is_defined = c_int::from(is_defined);
            let status = setup(of, is_defined, tolerance, start_seconds, 0, 0.0);
            match Status(status) {
                status if status.is_good() => Status(enter(of)),
                status => status,
            }
        };
        let own = OwnFunctions {
            numbers: numbers(&library),
            enter_initialization: Box::new(enter_initialization),
            step: step(&library)?,
            update: None,
        };
        let mut loaded = Loaded::of::<Two>(library, own)?;
        let callbacks = Box::new(Callbacks {
            logger,
            allocate,
            free,
            step_finished: None,
            environment: (&raw const *loaded.log).cast(),
        });
        let instantiate: Instantiate = function(&loaded.library, INSTANTIATE)?;
        let component = instantiate(
            name.as_ptr(),
            CO_SIMULATION,
            token.as_ptr(),
            resources.as_ptr(),
            &raw const *callbacks,
            0,
            1,
        );
        loaded.callbacks = Some(callbacks);
        loaded.with(component, INSTANTIATE)
    }
}

fn numbers(library: &Library) -> Vec<Numbers> {
    let truth = |value| c_int::from(value != 0.0);
    let number = |truth| f64::from(u8::from(truth != 0));
    // SAFETY: the types are those of FMI 2.0.
    unsafe {
        let integer = |kind| Numbers::of::<Two, c_int>(library, kind, "Integer", whole, f64::from);
        vec![
            Numbers::of::<Two, f64>(library, Kind::Float64, "Real", f64::from, f64::from),
            integer(Kind::Int32),
            integer(Kind::Enumeration),
            Numbers::of::<Two, c_int>(library, Kind::Boolean, "Boolean", truth, number),
        ]
    }
}

fn step(library: &Library) -> Result<Box<Step>, Fault> {
    // SAFETY: the types are those of FMI 2.0, and there is room for each value.
    unsafe {
        let step: DoStep = function(library, "fmi2DoStep")?;
        let real = function::<GetStatus<f64>>(library, "fmi2GetRealStatus").ok();
        let boolean = function::<GetStatus<c_int>>(library, "fmi2GetBooleanStatus").ok();
        Ok(Box::new(move |of, from_seconds, duration_seconds| {
            let status = Status(step(of, from_seconds, duration_seconds, 1));
            let (mut reached_seconds, mut is_terminated) = (from_seconds + duration_seconds, 0);
            if status == Status::DISCARD {
                reached_seconds = from_seconds;
                if let Some(real) = real {
                    real(of, LAST_SUCCESSFUL_TIME, &raw mut reached_seconds);
                }
                if let Some(boolean) = boolean {
                    boolean(of, TERMINATED, &raw mut is_terminated);
                }
            }
            Stepped {
                status,
                reached_seconds,
                needs_events: false,
                is_terminated: is_terminated != 0,
            }
        }))
    }
}
