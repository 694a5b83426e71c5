//! An instance in a library, for either version of FMI.

use std::any::Any;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr::null_mut;

use libloading::os::unix::Library;

use super::log::Log;
use super::{
    ENTER_EVENT_MODE, ENTER_STEP_MODE, EXIT_INITIALIZATION, Slave, Status, Stepped, TERMINATE,
    Updated, function,
};
use crate::description::Kind;
use crate::error::Fault;

pub(super) type Component = *mut c_void;
pub(super) type Plain = unsafe extern "C" fn(Component) -> c_int;

/// Functions of a version that read and write values of any type: the prefix of their names and their signatures.
pub(super) trait Family {
    const PREFIX: &'static str;
    type Get<T: 'static>: Copy + 'static;
    type Set<T: 'static>: Copy + 'static;

    /// # Safety
    /// `get` is a function of a library for `T`, whose component lives.
    unsafe fn get<T>(get: Self::Get<T>, of: Component, reference: u32, value: &mut T) -> c_int;

    /// # Safety
    /// As that of [`Family::get`].
    unsafe fn set<T>(set: Self::Set<T>, of: Component, reference: u32, value: &T) -> c_int;
}

/// Functions that read and write numbers of one kind.
pub(super) struct Numbers {
    kind: Kind,
    get: Box<dyn Fn(Component, u32) -> (Status, f64)>,
    set: Box<dyn Fn(Component, u32, f64) -> Status>,
}

impl Numbers {
    /// Returns the functions whose names end in `name`. A function that the library lacks fails when it is called.
    ///
    /// # Safety
    /// `T` is the type that FMI has for this name.
    pub(super) unsafe fn of<V: Family, T: Default + 'static>(
        library: &Library,
        kind: Kind,
        name: &str,
        of: fn(f64) -> T,
        number: fn(T) -> f64,
    ) -> Self {
        let prefix = V::PREFIX;
        // SAFETY: by the caller.
        let (get, set) = unsafe {
            let get = function::<V::Get<T>>(library, &format!("{prefix}Get{name}"));
            let set = function::<V::Set<T>>(library, &format!("{prefix}Set{name}"));
            (get.ok(), set.ok())
        };
        Self {
            kind,
            get: Box::new(move |component, reference| {
                let mut value = T::default();
                let status = get.map_or(Status::ERROR, |get| {
                    // SAFETY: one of the library's, for this type.
                    Status(unsafe { V::get(get, component, reference, &mut value) })
                });
                (status, number(value))
            }),
            set: Box::new(move |component, reference, value| {
                set.map_or(Status::ERROR, |set| {
                    // SAFETY: one of the library's, for this type.
                    Status(unsafe { V::set(set, component, reference, &of(value)) })
                })
            }),
        }
    }
}

/// Function that steps from a time for a duration, both in seconds.
pub(super) type Step = dyn Fn(Component, f64, f64) -> Stepped;

/// Function that enters the initialization at a start time, with a tolerance if there is one.
pub(super) type Enter = dyn Fn(Component, f64, Option<f64>) -> Status;

/// Function that updates the discrete states.
pub(super) type Update = dyn Fn(Component) -> (Status, Updated);

/// Function that sets a text by its reference.
type SetText = dyn Fn(Component, u32, &CStr) -> Status;

/// Functions that differ between the versions.
pub(super) struct OwnFunctions {
    pub(super) numbers: Vec<Numbers>,
    pub(super) enter_initialization: Box<Enter>,
    pub(super) step: Box<Step>,
    /// Update of the discrete states; `None` for an instance without events.
    pub(super) update: Option<Box<Update>>,
}

/// An instance.
pub(super) struct Loaded {
    /// The instance in the library; null before there is one, and when it is lost.
    component: Component,
    free_instance: unsafe extern "C" fn(Component),
    /// Functions that take no values; those of events only in an instance with events.
    plain: Vec<(&'static str, Plain)>,
    set_string: Box<SetText>,
    own: OwnFunctions,
    // Data that the component points to, for as long as it lives.
    pub(super) callbacks: Option<Box<dyn Any>>,
    pub(super) log: Box<Log>,
    pub(super) library: Library,
}

impl Loaded {
    /// Looks up the functions of a library that are alike in both versions, without an instance; `own` are the others.
    ///
    /// # Safety
    /// The library is of the version, and the given functions are its own.
    pub(super) unsafe fn of<V: Family>(library: Library, own: OwnFunctions) -> Result<Self, Fault> {
        let named = |name: &str| format!("{}{name}", V::PREFIX);
        let mut plain = vec![EXIT_INITIALIZATION, TERMINATE];
        if own.update.is_some() {
            plain.extend([ENTER_EVENT_MODE, ENTER_STEP_MODE]);
        }
        // SAFETY: both versions have these types, and the library lives as long as `Self`.
        unsafe {
            let set = function::<V::Set<*const c_char>>(&library, &named("SetString")).ok();
            Ok(Self {
                component: null_mut(),
                free_instance: function(&library, &named("FreeInstance"))?,
                plain: plain
                    .into_iter()
                    .map(|name| Ok((name, function(&library, &named(name))?)))
                    .collect::<Result<_, Fault>>()?,
                set_string: Box::new(move |component, reference, text| {
                    set.map_or(Status::ERROR, |set| {
                        // SAFETY: a text that lives through the call.
                        Status(V::set(set, component, reference, &text.as_ptr()))
                    })
                }),
                own,
                callbacks: None,
                log: Box::default(),
                library,
            })
        }
    }

    /// Adds the instance, which `function` returned.
    pub(super) fn with(
        mut self,
        component: Component,
        function: &'static str,
    ) -> Result<Self, Fault> {
        self.component = component;
        if component.is_null() {
            let log = self.log.take();
            return Err(Fault::call(function, "made no instance", None, &log));
        }
        Ok(self)
    }

    fn numbers(&self, kind: Kind) -> Option<&Numbers> {
        let mut numbers = self.own.numbers.iter();
        numbers.find(|numbers| numbers.kind == kind)
    }
}

impl Slave for Loaded {
    fn set_number(&mut self, kind: Kind, reference: u32, value: f64) -> Status {
        let numbers = self.numbers(kind);
        numbers.map_or(Status::ERROR, |numbers| {
            (numbers.set)(self.component, reference, value)
        })
    }

    fn number(&mut self, kind: Kind, reference: u32) -> (Status, f64) {
        let numbers = self.numbers(kind);
        let got = numbers.map(|numbers| (numbers.get)(self.component, reference));
        got.unwrap_or((Status::ERROR, 0.0))
    }

    fn set_text(&mut self, reference: u32, text: &CStr) -> Status {
        (self.set_string)(self.component, reference, text)
    }

    fn enter_initialization(&mut self, start_seconds: f64, tolerance: Option<f64>) -> Status {
        (self.own.enter_initialization)(self.component, start_seconds, tolerance)
    }

    fn step(&mut self, from_seconds: f64, duration_seconds: f64) -> Stepped {
        (self.own.step)(self.component, from_seconds, duration_seconds)
    }

    fn update_discrete(&mut self) -> (Status, Updated) {
        let update = self.own.update.as_ref();
        let updated = update.map(|update| update(self.component));
        updated.unwrap_or((Status::ERROR, Updated::default()))
    }

    fn call(&mut self, function: &'static str) -> Status {
        match self.plain.iter().find(|(plain, _)| *plain == function) {
            // SAFETY: a function of the library, and a component that lives.
            Some((_, plain)) => Status(unsafe { plain(self.component) }),
            None => Status::ERROR,
        }
    }

    fn log(&mut self) -> String {
        self.log.take()
    }

    fn forsake(&mut self) {
        self.component = null_mut();
    }
}

impl Drop for Loaded {
    fn drop(&mut self) {
        if !self.component.is_null() {
            // SAFETY: a component that lives, for the last time.
            unsafe { (self.free_instance)(self.component) };
        }
    }
}
