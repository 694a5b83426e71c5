//! The instance behind a component, and the functions of both versions that differ in their names only.
#![expect(unsafe_code, reason = "C hands over the pointers")]

use std::ffi::{CStr, CString, c_char, c_int, c_void};

use super::played::{Played, guarded};

pub(super) type Component = *mut c_void;

pub(super) const OK: c_int = 0;
pub(super) const ERROR: c_int = 3;
pub(super) const FATAL: c_int = 4;

/// Callback that gives the importer a status and its reason.
type Tell = Box<dyn Fn(c_int, &CStr)>;

struct Instance {
    played: Played,
    tell: Tell,
}

fn told(tell: &Tell, (status, message): (c_int, String)) -> c_int {
    tell(status, &CString::new(message).unwrap_or_default());
    status
}

/// Makes a component; null if `make` fails.
pub(super) fn made(make: impl FnOnce() -> Result<Played, String>, tell: Tell) -> Component {
    match guarded(make) {
        Ok(played) => Box::into_raw(Box::new(Instance { played, tell })).cast(),
        Err(failure) => {
            told(&tell, failure);
            std::ptr::null_mut()
        }
    }
}

/// # Safety `component` is null, or a pointer of [`made`] that is not freed yet; as in all functions below.
pub(super) unsafe fn free(component: Component) {
    if !component.is_null() {
        // SAFETY: `made` returned the pointer, and this is its last use.
        drop(unsafe { Box::from_raw(component.cast::<Instance>()) });
    }
}

/// # Safety
/// As that of [`free`].
pub(super) unsafe fn on(
    component: Component,
    work: impl FnOnce(&mut Played) -> Result<(), String>,
) -> c_int {
    // SAFETY: by the caller.
    let Some(instance) = (unsafe { component.cast::<Instance>().as_mut() }) else {
        return ERROR;
    };
    match guarded(|| work(&mut instance.played)) {
        Ok(()) => OK,
        Err(failure) => told(&instance.tell, failure),
    }
}

/// # Safety
/// Null, or `count` values that live through the call.
unsafe fn slice<'a, T>(values: *const T, count: usize) -> &'a [T] {
    if values.is_null() {
        &[]
    } else {
        // SAFETY: by the caller.
        unsafe { std::slice::from_raw_parts(values, count) }
    }
}

/// Reads a value for each reference.
///
/// # Safety
/// As that of [`free`], with as many references as room for values.
pub(super) unsafe fn get<T>(
    component: Component,
    references: *const u32,
    count: usize,
    values: *mut T,
    value: impl Fn(&mut Played, u32) -> Result<T, String>,
) -> c_int {
    // SAFETY: by the caller.
    unsafe {
        on(component, |played| {
            for (place, reference) in slice(references, count).iter().enumerate() {
                *values.add(place) = value(played, *reference)?;
            }
            Ok(())
        })
    }
}

/// Sets a value for each reference.
///
/// # Safety
/// As that of [`free`], with as many references as values.
pub(super) unsafe fn set<T: Copy>(
    component: Component,
    references: *const u32,
    count: usize,
    values: *const T,
    set: impl Fn(&mut Played, u32, T) -> Result<(), String>,
) -> c_int {
    // SAFETY: by the caller.
    unsafe {
        let mut pairs = slice(references, count).iter().zip(slice(values, count));
        on(component, |played| {
            pairs.try_for_each(|(reference, value)| set(played, *reference, *value))
        })
    }
}

/// Returns a text for C.
pub(super) fn text(played: &mut Played, reference: u32) -> Result<*const c_char, String> {
    Ok(played.word(reference)?.as_ptr())
}

/// Defines functions of an instance alone. As in the tables below, C passes any further arguments without effect.
macro_rules! on_instance {
    ($($name:ident: $work:expr;)+) => {
        $(
            #[unsafe(no_mangle)]
            pub(super) unsafe extern "C" fn $name(component: Component) -> c_int {
                // SAFETY: a component, by FMI.
                unsafe { on(component, $work) }
            }
        )+
    };
}

/// Defines functions that read a value for each reference. No variable is an array.
macro_rules! getters {
    ($($name:ident($value:ty): $get:expr;)+) => {
        $(
            #[unsafe(no_mangle)]
            pub(super) unsafe extern "C" fn $name(
                component: Component,
                references: *const u32,
                count: usize,
                values: *mut $value,
            ) -> c_int {
                // SAFETY: a component, and as many references as room for values, by FMI.
                unsafe { get(component, references, count, values, $get) }
            }
        )+
    };
}

/// Defines functions that set a value for each reference.
macro_rules! setters {
    ($($name:ident($value:ty): $set:expr;)+) => {
        $(
            #[unsafe(no_mangle)]
            pub(super) unsafe extern "C" fn $name(
                component: Component,
                references: *const u32,
                count: usize,
                values: *const $value,
            ) -> c_int {
                // SAFETY: a component, and as many references as values, by FMI; texts are C strings.
                unsafe { set(component, references, count, values, $set) }
            }
        )+
    };
}

/// Defines functions of unsupported features. They only refuse.
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

/// Defines functions for values of a type that no variable has. Every such value is refused; an empty request succeeds.
macro_rules! of_no_variable {
    ($($name:ident)+) => {
        $(
            #[unsafe(no_mangle)]
            pub(super) extern "C" fn $name(_component: Component, _references: *const u32, count: usize) -> c_int {
                if count == 0 { OK } else { ERROR }
            }
        )+
    };
}

pub(super) use {getters, not_served, of_no_variable, on_instance, setters};
