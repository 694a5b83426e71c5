//! The functions of FMI 2.0 for co-simulation, by `fmi2FunctionTypes.h`.

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::ptr::null_mut;

use libloading::os::unix::Library;

use super::log::Log;
use super::{Made, Slave, Status, Stepped, Updated, function, whole};
use crate::description::Kind;
use crate::error::Fault;

type Component = *mut c_void;
type Plain = unsafe extern "C" fn(Component) -> c_int;
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

/// `fmi2CoSimulation`.
const CO_SIMULATION: c_int = 1;
/// `fmi2LastSuccessfulTime`.
const LAST_SUCCESSFUL_TIME: c_int = 2;
/// `fmi2Terminated`.
const TERMINATED: c_int = 3;

/// `fmi2CallbackFunctions`.
#[repr(C)]
struct Callbacks {
    /// In C it takes any number of arguments. Those that FMI names come where they come for a function of just these, on all
    /// platforms that are served.
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
    // SAFETY: what `allocate` returned, by FMI.
    unsafe { libc::free(memory) }
}

/// Keeps the format of a message, or the text of one whose format is `%s`.
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

/// An instance.
pub(super) struct Two {
    component: Component,
    is_alive: bool,
    free_instance: unsafe extern "C" fn(Component),
    setup_experiment: SetupExperiment,
    enter_initialization: Plain,
    exit_initialization: Plain,
    terminate: Plain,
    do_step: DoStep,
    real_status: Option<GetStatus<f64>>,
    boolean_status: Option<GetStatus<c_int>>,
    get_real: Get<f64>,
    set_real: Set<f64>,
    get_integer: Option<Get<c_int>>,
    set_integer: Option<Set<c_int>>,
    get_boolean: Option<Get<c_int>>,
    set_boolean: Option<Set<c_int>>,
    set_string: Option<Set<*const c_char>>,
    // What the component points to, for as long as it lives.
    callbacks: Box<Callbacks>,
    log: Box<Log>,
    library: Library,
}

impl Two {
    pub(super) fn new(library: Library, name: &CStr, made: &Made<'_>) -> Result<Self, Fault> {
        let log = Box::new(Log::default());
        let callbacks = Box::new(Callbacks {
            logger,
            allocate,
            free,
            step_finished: None,
            environment: (&raw const *log).cast(),
        });
        // SAFETY: the types are those of FMI 2.0, and the library lives as long as `Self`.
        let mut two = unsafe {
            Self {
                component: null_mut(),
                is_alive: false,
                free_instance: function(&library, "fmi2FreeInstance")?,
                setup_experiment: function(&library, "fmi2SetupExperiment")?,
                enter_initialization: function(&library, "fmi2EnterInitializationMode")?,
                exit_initialization: function(&library, "fmi2ExitInitializationMode")?,
                terminate: function(&library, "fmi2Terminate")?,
                do_step: function(&library, "fmi2DoStep")?,
                real_status: function(&library, "fmi2GetRealStatus").ok(),
                boolean_status: function(&library, "fmi2GetBooleanStatus").ok(),
                get_real: function(&library, "fmi2GetReal")?,
                set_real: function(&library, "fmi2SetReal")?,
                get_integer: function(&library, "fmi2GetInteger").ok(),
                set_integer: function(&library, "fmi2SetInteger").ok(),
                get_boolean: function(&library, "fmi2GetBoolean").ok(),
                set_boolean: function(&library, "fmi2SetBoolean").ok(),
                set_string: function(&library, "fmi2SetString").ok(),
                callbacks,
                log,
                library,
            }
        };
        // SAFETY: as above; all texts live through the call, callbacks and log as long as the component.
        two.component = unsafe {
            let instantiate: Instantiate = function(&two.library, "fmi2Instantiate")?;
            instantiate(
                name.as_ptr(),
                CO_SIMULATION,
                made.token.as_ptr(),
                made.resources.as_ptr(),
                &raw const *two.callbacks,
                0,
                1,
            )
        };
        if two.component.is_null() {
            return Err(Fault::Call {
                function: "fmi2Instantiate",
                outcome: "made no instance".to_owned(),
                time_seconds: None,
                log: two.log.take(),
            });
        }
        two.is_alive = true;
        Ok(two)
    }

    fn get<T: Copy + Default>(&self, get: Option<Get<T>>, reference: u32) -> (Status, T) {
        let mut value = T::default();
        let Some(get) = get else {
            return (Status::Error, value);
        };
        // SAFETY: one reference and room for one value.
        let status = unsafe { get(self.component, &raw const reference, 1, &raw mut value) };
        (Status::of(status), value)
    }

    fn set<T>(&self, set: Option<Set<T>>, reference: u32, value: &T) -> Status {
        let Some(set) = set else {
            return Status::Error;
        };
        // SAFETY: one reference and one value, which live through the call.
        Status::of(unsafe { set(self.component, &raw const reference, 1, value) })
    }
}

impl Slave for Two {
    fn set_number(&mut self, kind: Kind, reference: u32, value: f64) -> Status {
        match kind {
            Kind::Boolean => self.set(self.set_boolean, reference, &c_int::from(value != 0.0)),
            Kind::Int32 | Kind::Enumeration => {
                self.set(self.set_integer, reference, &whole::<c_int>(value))
            }
            _ => self.set(Some(self.set_real), reference, &value),
        }
    }

    fn number(&mut self, kind: Kind, reference: u32, value: &mut f64) -> Status {
        let (status, number) = match kind {
            Kind::Boolean => {
                let (status, truth) = self.get(self.get_boolean, reference);
                (status, f64::from(u8::from(truth != 0)))
            }
            Kind::Int32 | Kind::Enumeration => {
                let (status, number) = self.get(self.get_integer, reference);
                (status, f64::from(number))
            }
            _ => self.get(Some(self.get_real), reference),
        };
        *value = number;
        status
    }

    fn set_text(&mut self, reference: u32, text: &CStr) -> Status {
        self.set(self.set_string, reference, &text.as_ptr())
    }

    fn enter_initialization(&mut self, start_seconds: f64, tolerance: Option<f64>) -> Status {
        let is_defined = c_int::from(tolerance.is_some());
        let tolerance = tolerance.unwrap_or_default();
        // SAFETY: a component that lives, as in all calls below.
        let status = Status::of(unsafe {
            (self.setup_experiment)(self.component, is_defined, tolerance, start_seconds, 0, 0.0)
        });
        if !status.is_good() {
            return status;
        }
        // SAFETY: as above.
        Status::of(unsafe { (self.enter_initialization)(self.component) })
    }

    fn exit_initialization(&mut self) -> Status {
        // SAFETY: as above.
        Status::of(unsafe { (self.exit_initialization)(self.component) })
    }

    fn step(&mut self, from_seconds: f64, duration_seconds: f64) -> Stepped {
        // SAFETY: as above.
        let status = Status::of(unsafe {
            (self.do_step)(self.component, from_seconds, duration_seconds, 1)
        });
        let mut stepped = Stepped {
            status,
            reached_seconds: from_seconds + duration_seconds,
            needs_events: false,
            is_terminated: false,
        };
        if status == Status::Discard {
            let mut reached = from_seconds;
            if let Some(real_status) = self.real_status {
                // SAFETY: as above, with room for one value.
                unsafe { real_status(self.component, LAST_SUCCESSFUL_TIME, &raw mut reached) };
            }
            let mut is_terminated = 0;
            if let Some(boolean_status) = self.boolean_status {
                // SAFETY: as above, with room for one value.
                unsafe { boolean_status(self.component, TERMINATED, &raw mut is_terminated) };
            }
            stepped.reached_seconds = reached;
            stepped.is_terminated = is_terminated != 0;
        }
        stepped
    }

    fn enter_events(&mut self) -> Status {
        Status::Ok
    }

    fn update_discrete(&mut self) -> (Status, Updated) {
        (Status::Ok, Updated::default())
    }

    fn enter_steps(&mut self) -> Status {
        Status::Ok
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

impl Drop for Two {
    fn drop(&mut self) {
        if self.is_alive {
            // SAFETY: a component that lives, for the last time.
            unsafe { (self.free_instance)(self.component) };
        }
    }
}
