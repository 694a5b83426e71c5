//! The functions of FMI 3.0 for co-simulation, by `fmi3FunctionTypes.h`.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr::{null, null_mut};

use libloading::os::unix::Library;

use super::log::Log;
use super::{Made, Slave, Status, Stepped, Updated, function, number_of, whole};
use crate::description::Kind;
use crate::error::Fault;

type Component = *mut c_void;
type Plain = unsafe extern "C" fn(Component) -> c_int;
type Get<T> = unsafe extern "C" fn(Component, *const u32, usize, *mut T, usize) -> c_int;
type Set<T> = unsafe extern "C" fn(Component, *const u32, usize, *const T, usize) -> c_int;
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
/// Truths are bytes here: a stranger's byte that is neither 0 nor 1 is no `bool`.
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

/// What reads and writes values of one type, where the library has it.
struct Values<T> {
    get: Option<Get<T>>,
    set: Option<Set<T>>,
}

impl<T: Copy + Default> Values<T> {
    /// # Safety
    /// `T` is what FMI 3.0 has for this type.
    unsafe fn of(library: &Library, kind: &str) -> Self {
        // SAFETY: by the caller.
        unsafe {
            Self {
                get: function(library, &format!("fmi3Get{kind}")).ok(),
                set: function(library, &format!("fmi3Set{kind}")).ok(),
            }
        }
    }

    fn get(&self, component: Component, reference: u32) -> (Status, T) {
        let mut value = T::default();
        let Some(get) = self.get else {
            return (Status::Error, value);
        };
        // SAFETY: one reference and room for one value.
        let status = unsafe { get(component, &raw const reference, 1, &raw mut value, 1) };
        (Status::of(status), value)
    }

    fn set(&self, component: Component, reference: u32, value: T) -> Status {
        let Some(set) = self.set else {
            return Status::Error;
        };
        // SAFETY: one reference and one value, which live through the call.
        Status::of(unsafe { set(component, &raw const reference, 1, &raw const value, 1) })
    }
}

/// An instance.
pub(super) struct Three {
    component: Component,
    is_alive: bool,
    free_instance: unsafe extern "C" fn(Component),
    enter_initialization: EnterInitialization,
    exit_initialization: Plain,
    terminate: Plain,
    do_step: DoStep,
    enter_events: Option<Plain>,
    enter_steps: Option<Plain>,
    update_discrete: Option<UpdateDiscrete>,
    float64: Values<f64>,
    float32: Values<f32>,
    int8: Values<i8>,
    uint8: Values<u8>,
    int16: Values<i16>,
    uint16: Values<u16>,
    int32: Values<i32>,
    uint32: Values<u32>,
    int64: Values<i64>,
    uint64: Values<u64>,
    boolean: Values<u8>,
    set_string: Option<Set<*const c_char>>,
    // What the component points to, for as long as it lives.
    log: Box<Log>,
    library: Library,
}

impl Three {
    pub(super) fn new(library: Library, name: &CStr, made: &Made<'_>) -> Result<Self, Fault> {
        let mut three = Self::of(library)?;
        if made.co_simulation.has_event_mode {
            let events = [
                ("fmi3EnterEventMode", three.enter_events.is_none()),
                ("fmi3EnterStepMode", three.enter_steps.is_none()),
                ("fmi3UpdateDiscreteStates", three.update_discrete.is_none()),
            ];
            if let Some((missing, _)) = events.into_iter().find(|(_, is_missing)| *is_missing) {
                return Err(Fault::Symbol(missing.to_owned()));
            }
        }
        let environment: *const Log = &raw const *three.log;
        // SAFETY: the type is that of FMI 3.0; all texts live through the call, the log as long as the component.
        three.component = unsafe {
            let instantiate: Instantiate = function(&three.library, "fmi3InstantiateCoSimulation")?;
            instantiate(
                name.as_ptr(),
                made.token.as_ptr(),
                made.resources.as_ptr(),
                false,
                true,
                made.co_simulation.has_event_mode,
                true,
                null(),
                0,
                environment.cast(),
                log_message,
                null(),
            )
        };
        if three.component.is_null() {
            return Err(Fault::Call {
                function: "fmi3InstantiateCoSimulation",
                outcome: "made no instance".to_owned(),
                time_seconds: None,
                log: three.log.take(),
            });
        }
        three.is_alive = true;
        Ok(three)
    }

    fn of(library: Library) -> Result<Self, Fault> {
        // SAFETY: the types are those of FMI 3.0, and the library lives as long as `Self`.
        Ok(unsafe {
            Self {
                component: null_mut(),
                is_alive: false,
                free_instance: function(&library, "fmi3FreeInstance")?,
                enter_initialization: function(&library, "fmi3EnterInitializationMode")?,
                exit_initialization: function(&library, "fmi3ExitInitializationMode")?,
                terminate: function(&library, "fmi3Terminate")?,
                do_step: function(&library, "fmi3DoStep")?,
                enter_events: function(&library, "fmi3EnterEventMode").ok(),
                enter_steps: function(&library, "fmi3EnterStepMode").ok(),
                update_discrete: function(&library, "fmi3UpdateDiscreteStates").ok(),
                float64: Values::of(&library, "Float64"),
                float32: Values::of(&library, "Float32"),
                int8: Values::of(&library, "Int8"),
                uint8: Values::of(&library, "UInt8"),
                int16: Values::of(&library, "Int16"),
                uint16: Values::of(&library, "UInt16"),
                int32: Values::of(&library, "Int32"),
                uint32: Values::of(&library, "UInt32"),
                int64: Values::of(&library, "Int64"),
                uint64: Values::of(&library, "UInt64"),
                boolean: Values::of(&library, "Boolean"),
                set_string: function(&library, "fmi3SetString").ok(),
                log: Box::new(Log::default()),
                library,
            }
        })
    }
}

impl Slave for Three {
    fn set_number(&mut self, kind: Kind, reference: u32, value: f64) -> Status {
        let component = self.component;
        match kind {
            Kind::Float32 => {
                #[expect(clippy::cast_possible_truncation, reason = "its own precision")]
                let value = value as f32;
                self.float32.set(component, reference, value)
            }
            Kind::Int8 => self.int8.set(component, reference, whole(value)),
            Kind::UInt8 => self.uint8.set(component, reference, whole(value)),
            Kind::Int16 => self.int16.set(component, reference, whole(value)),
            Kind::UInt16 => self.uint16.set(component, reference, whole(value)),
            Kind::Int32 => self.int32.set(component, reference, whole(value)),
            Kind::UInt32 => self.uint32.set(component, reference, whole(value)),
            Kind::Int64 | Kind::Enumeration => self.int64.set(component, reference, whole(value)),
            Kind::UInt64 => self.uint64.set(component, reference, whole(value)),
            Kind::Boolean => (self.boolean).set(component, reference, u8::from(value != 0.0)),
            _ => self.float64.set(component, reference, value),
        }
    }

    fn number(&mut self, kind: Kind, reference: u32, value: &mut f64) -> Status {
        fn taken<T>((status, got): (Status, T), value: &mut f64, number: fn(T) -> f64) -> Status {
            *value = number(got);
            status
        }
        let component = self.component;
        match kind {
            Kind::Float32 => taken(self.float32.get(component, reference), value, f64::from),
            Kind::Int8 => taken(self.int8.get(component, reference), value, f64::from),
            Kind::UInt8 => taken(self.uint8.get(component, reference), value, f64::from),
            Kind::Int16 => taken(self.int16.get(component, reference), value, f64::from),
            Kind::UInt16 => taken(self.uint16.get(component, reference), value, f64::from),
            Kind::Int32 => taken(self.int32.get(component, reference), value, f64::from),
            Kind::UInt32 => taken(self.uint32.get(component, reference), value, f64::from),
            Kind::Int64 | Kind::Enumeration => {
                taken(self.int64.get(component, reference), value, number_of)
            }
            Kind::UInt64 => taken(self.uint64.get(component, reference), value, |number| {
                number_of(i64::try_from(number).unwrap_or(i64::MAX))
            }),
            Kind::Boolean => taken(self.boolean.get(component, reference), value, |truth| {
                f64::from(u8::from(truth != 0))
            }),
            _ => taken(self.float64.get(component, reference), value, |number| {
                number
            }),
        }
    }

    fn set_text(&mut self, reference: u32, text: &CStr) -> Status {
        let Some(set) = self.set_string else {
            return Status::Error;
        };
        let text = text.as_ptr();
        // SAFETY: one reference and one text, which live through the call.
        Status::of(unsafe { set(self.component, &raw const reference, 1, &raw const text, 1) })
    }

    fn enter_initialization(&mut self, start_seconds: f64, tolerance: Option<f64>) -> Status {
        let is_defined = tolerance.is_some();
        let tolerance = tolerance.unwrap_or_default();
        // SAFETY: a component that lives, as in all calls below.
        Status::of(unsafe {
            (self.enter_initialization)(
                self.component,
                is_defined,
                tolerance,
                start_seconds,
                false,
                0.0,
            )
        })
    }

    fn exit_initialization(&mut self) -> Status {
        // SAFETY: as above.
        Status::of(unsafe { (self.exit_initialization)(self.component) })
    }

    fn step(&mut self, from_seconds: f64, duration_seconds: f64) -> Stepped {
        let (mut needs_events, mut is_terminated, mut returned_early) = (0, 0, 0);
        let mut last = from_seconds;
        // SAFETY: as above, with room for each value.
        let status = Status::of(unsafe {
            (self.do_step)(
                self.component,
                from_seconds,
                duration_seconds,
                true,
                &raw mut needs_events,
                &raw mut is_terminated,
                &raw mut returned_early,
                &raw mut last,
            )
        });
        let end = from_seconds + duration_seconds;
        // Some do not write the time where the step was done.
        let is_done = status.is_good() && returned_early == 0;
        Stepped {
            status,
            reached_seconds: if is_done { end } else { last },
            needs_events: needs_events != 0,
            is_terminated: is_terminated != 0,
        }
    }

    fn enter_events(&mut self) -> Status {
        (self.enter_events).map_or(Status::Error, |enter| {
            // SAFETY: as above.
            Status::of(unsafe { enter(self.component) })
        })
    }

    fn update_discrete(&mut self) -> (Status, Updated) {
        let Some(update) = self.update_discrete else {
            return (Status::Error, Updated::default());
        };
        let (mut again, mut is_terminated, mut nominals, mut values) = (0, 0, 0, 0);
        let (mut has_next, mut next) = (0, 0.0);
        // SAFETY: as above, with room for each value.
        let status = unsafe {
            update(
                self.component,
                &raw mut again,
                &raw mut is_terminated,
                &raw mut nominals,
                &raw mut values,
                &raw mut has_next,
                &raw mut next,
            )
        };
        let updated = Updated {
            again: again != 0,
            is_terminated: is_terminated != 0,
            next_event_seconds: (has_next != 0).then_some(next),
        };
        (Status::of(status), updated)
    }

    fn enter_steps(&mut self) -> Status {
        (self.enter_steps).map_or(Status::Error, |enter| {
            // SAFETY: as above.
            Status::of(unsafe { enter(self.component) })
        })
    }

    fn terminate(&mut self) -> Status {
        // SAFETY: as above.
        Status::of(unsafe { (self.terminate)(self.component) })
    }

    fn log(&mut self) -> String {
        self.log.take()
    }

    fn forsake(&mut self) {
        self.is_alive = false;
    }
}

impl Drop for Three {
    fn drop(&mut self) {
        if self.is_alive {
            // SAFETY: a component that lives, for the last time.
            unsafe { (self.free_instance)(self.component) };
        }
    }
}
