//! The functions of FMI 3.0 for co-simulation, by `fmi3FunctionTypes.h`.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr::null;

use libloading::os::unix::Library;

use super::loaded::{Component, Family, Loaded, Numbers, OwnFunctions, Step, Update};
use super::log::Log;
use super::{Status, Stepped, Updated, function, whole};
use crate::description::Kind;
use crate::error::Fault;

type Get<T> = unsafe extern "C" fn(Component, *const u32, usize, *mut T, usize) -> c_int;
type Set<T> = unsafe extern "C" fn(Component, *const u32, usize, *const T, usize) -> c_int;
/// Name of the function that makes an instance.
const INSTANTIATE: &str = "fmi3InstantiateCoSimulation";

type LogMessage = unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char);
type Instantiate = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    bool,
    bool,
    bool,
    bool,
    *const u32,
    usize,
    *const c_void,
    LogMessage,
    *const c_void,
) -> Component;
type EnterInitialization = unsafe extern "C" fn(Component, bool, f64, f64, bool, f64) -> c_int;
/// Booleans are bytes here: a foreign byte that is neither 0 nor 1 is no valid `bool`.
type DoStep =
    unsafe extern "C" fn(Component, f64, f64, bool, *mut u8, *mut u8, *mut u8, *mut f64) -> c_int;
type UpdateDiscrete =
    unsafe extern "C" fn(Component, *mut u8, *mut u8, *mut u8, *mut u8, *mut u8, *mut f64) -> c_int;

unsafe extern "C" fn log_message(
    environment: *mut c_void,
    _status: c_int,
    _category: *const c_char,
    message: *const c_char,
) {
    if !environment.is_null() {
        // SAFETY: the environment is the instance's log, which lives longer than the instance; the message is a C string.
        unsafe { (*environment.cast::<Log>()).keep(message) };
    }
}

/// Functions of FMI 3.0.
struct Three;

impl Family for Three {
    const PREFIX: &'static str = "fmi3";
    type Get<T: 'static> = Get<T>;
    type Set<T: 'static> = Set<T>;

    unsafe fn get<T>(get: Get<T>, of: Component, reference: u32, value: &mut T) -> c_int {
        // SAFETY: by the caller, with one reference and room for one value.
        unsafe { get(of, &raw const reference, 1, value, 1) }
    }

    unsafe fn set<T>(set: Set<T>, of: Component, reference: u32, value: &T) -> c_int {
        // SAFETY: by the caller, with one reference and one value.
        unsafe { set(of, &raw const reference, 1, value, 1) }
    }
}

/// Makes an instance in a library.
pub(super) fn instance(
    library: Library,
    name: &CStr,
    token: &CStr,
    resources: &CStr,
    has_events: bool,
) -> Result<Loaded, Fault> {
    // SAFETY: the types are those of FMI 3.0, and the library lives as long as the instance, as the log does. All texts live
    // through the call.
    unsafe {
        let enter: EnterInitialization = function(&library, "fmi3EnterInitializationMode")?;
        let enter_initialization = move |of, start_seconds, tolerance: Option<f64>| {
            let (is_defined, tolerance) = (tolerance.is_some(), tolerance.unwrap_or_default());
            Status(enter(of, is_defined, tolerance, start_seconds, false, 0.0))
        };
        let own = OwnFunctions {
            numbers: numbers(&library),
            enter_initialization: Box::new(enter_initialization),
            step: step(&library)?,
            update: has_events.then(|| update(&library)).transpose()?,
        };
        let loaded = Loaded::of::<Three>(library, own)?;
        let instantiate: Instantiate = function(&loaded.library, INSTANTIATE)?;
        let component = instantiate(
            name.as_ptr(),
            token.as_ptr(),
            resources.as_ptr(),
            false,
            true,
            has_events,
            true,
            null(),
            0,
            (&raw const *loaded.log).cast(),
            log_message,
            null(),
        );
        loaded.with(component, INSTANTIATE)
    }
}

fn numbers(library: &Library) -> Vec<Numbers> {
    #[expect(clippy::cast_possible_truncation, reason = "its own precision")]
    let single = |value| value as f32;
    // Above 2^53 the nearest float.
    let signed = |number: i64| number as f64;
    let unsigned = |number: u64| number as f64;
    let truth = |value| u8::from(value != 0.0);
    let number = |truth| f64::from(u8::from(truth != 0));
    // SAFETY: the types are those of FMI 3.0.
    unsafe {
        let int64 = |kind| Numbers::of::<Three, i64>(library, kind, "Int64", whole, signed);
        vec![
            Numbers::of::<Three, f64>(library, Kind::Float64, "Float64", f64::from, f64::from),
            Numbers::of::<Three, f32>(library, Kind::Float32, "Float32", single, f64::from),
            Numbers::of::<Three, i8>(library, Kind::Int8, "Int8", whole, f64::from),
            Numbers::of::<Three, u8>(library, Kind::UInt8, "UInt8", whole, f64::from),
            Numbers::of::<Three, i16>(library, Kind::Int16, "Int16", whole, f64::from),
            Numbers::of::<Three, u16>(library, Kind::UInt16, "UInt16", whole, f64::from),
            Numbers::of::<Three, i32>(library, Kind::Int32, "Int32", whole, f64::from),
            Numbers::of::<Three, u32>(library, Kind::UInt32, "UInt32", whole, f64::from),
            int64(Kind::Int64),
            int64(Kind::Enumeration),
            Numbers::of::<Three, u64>(library, Kind::UInt64, "UInt64", whole, unsigned),
            Numbers::of::<Three, u8>(library, Kind::Boolean, "Boolean", truth, number),
        ]
    }
}

fn step(library: &Library) -> Result<Box<Step>, Fault> {
    // SAFETY: the type is that of FMI 3.0, and there is room for each value.
    unsafe {
        let step: DoStep = function(library, "fmi3DoStep")?;
        Ok(Box::new(move |of, from_seconds, duration_seconds| {
            let (mut needs_events, mut is_terminated, mut returned_early) = (0, 0, 0);
            let mut last = from_seconds;
            let status = Status(step(
                of,
                from_seconds,
                duration_seconds,
                true,
                &raw mut needs_events,
                &raw mut is_terminated,
                &raw mut returned_early,
                &raw mut last,
            ));
            let end = from_seconds + duration_seconds;
            // Some FMUs do not write the time after a complete step.
            let is_done = status.is_good() && returned_early == 0;
            Stepped {
                status,
                reached_seconds: if is_done { end } else { last },
                needs_events: needs_events != 0,
                is_terminated: is_terminated != 0,
            }
        }))
    }
}

fn update(library: &Library) -> Result<Box<Update>, Fault> {
    // SAFETY: the type is that of FMI 3.0, and there is room for each value.
    unsafe {
        let update: UpdateDiscrete = function(library, "fmi3UpdateDiscreteStates")?;
        Ok(Box::new(move |of| {
            let (mut again, mut is_terminated, mut nominals, mut values) = (0, 0, 0, 0);
            let (mut has_next, mut next) = (0, 0.0);
            let status = update(
                of,
                &raw mut again,
                &raw mut is_terminated,
                &raw mut nominals,
                &raw mut values,
                &raw mut has_next,
                &raw mut next,
            );
            let updated = Updated {
                again: again != 0,
                is_terminated: is_terminated != 0,
                next_event_seconds: (has_next != 0).then_some(next),
            };
            (Status(status), updated)
        }))
    }
}
