//! A control law in a shared library: the functions of `include/canrig_law.h` behind safe ones.

use std::any::Any;
use std::ffi::{CStr, CString, c_char, c_double, c_int, c_void};
use std::path::Path;

use libloading::os::unix::Library;
use scenario::process_law::LawSetup;

use super::{function, open, text};
use crate::error::Fault;

const BYTES_MAX: usize = 1 << 30;
const WHY_BYTES: usize = 256;

type Bytes = unsafe extern "C" fn(*const SetupInC) -> usize;
type Init = unsafe extern "C" fn(*mut c_void, *const SetupInC, *mut c_char) -> c_int;
type Step = unsafe extern "C" fn(
    *mut c_void,
    c_double,
    c_double,
    *const c_double,
    *mut c_double,
    *mut c_double,
) -> c_int;

/// `canrig_law_setup`.
#[repr(C)]
struct SetupInC {
    version: u32,
    reads_count: u32,
    writes_count: u32,
    terms_count: u32,
    parameters_count: u32,
    reserved: u32,
    reads: *const *const c_char,
    writes: *const *const c_char,
    terms: *const *const c_char,
    parameters: *const *const c_char,
    parameter_values: *const c_double,
    mins: *const c_double,
    maxs: *const c_double,
    period_seconds: c_double,
    seed: u64,
}

fn texts<'a>(names: impl IntoIterator<Item = &'a String>) -> Result<Vec<CString>, Fault> {
    names.into_iter().map(|name| text(name)).collect()
}

/// A law of a library, with its memory. It runs foreign code, so only a worker process may load it.
pub struct LawLibrary {
    step: Step,
    /// Memory of the law, aligned as `max_align_t`.
    memory: Vec<u128>,
    // The setup that the law was given stays in place with all that it points to, and the library is closed last.
    setup: Box<SetupInC>,
    _pointed_to: Box<dyn Any>,
    _library: Library,
}

impl LawLibrary {
    /// Loads a library and prepares its law, for a run with this seed.
    ///
    /// # Errors
    /// The library cannot be loaded, lacks a function, or its law does not accept the setup.
    pub fn load(path: &Path, setup: &LawSetup, seed: u64) -> Result<Self, Fault> {
        let library = open(path)?;
        // SAFETY: the header gives the functions these types, and the library is closed last.
        let (bytes, init, step) = unsafe {
            (
                function::<Bytes>(&library, "canrig_law_bytes")?,
                function::<Init>(&library, "canrig_law_init")?,
                function::<Step>(&library, "canrig_law_step")?,
            )
        };
        let parameters = setup.parameters.iter().filter_map(|(name, value)| {
            let whole = || value.as_integer().map(|whole| whole as f64);
            Some((name, value.as_float().or_else(whole)?))
        });
        let texts = [
            texts(&setup.reads)?,
            texts(&setup.writes)?,
            texts(&setup.terms)?,
            texts(parameters.clone().map(|(name, _)| name))?,
        ];
        let names = texts.each_ref().map(|texts| {
            let pointers = texts.iter().map(|text| text.as_ptr());
            Vec::from_iter(pointers)
        });
        let [reads, writes, terms, parameter_names] = &names;
        let count = |names: &Vec<_>| {
            let count = u32::try_from(names.len());
            count.map_err(|error| Fault::Invalid(error.to_string()))
        };
        let parameter_values = Vec::from_iter(parameters.map(|(_, value)| value));
        let ranges = setup.ranges.iter().map(|[min, max]| (*min, *max));
        let (mins, maxs): (Vec<f64>, Vec<f64>) = ranges.unzip();
        let given = Box::new(SetupInC {
            version: 1,
            reads_count: count(reads)?,
            writes_count: count(writes)?,
            terms_count: count(terms)?,
            parameters_count: count(parameter_names)?,
            reserved: 0,
            reads: reads.as_ptr(),
            writes: writes.as_ptr(),
            terms: terms.as_ptr(),
            parameters: parameter_names.as_ptr(),
            parameter_values: parameter_values.as_ptr(),
            mins: mins.as_ptr(),
            maxs: maxs.as_ptr(),
            period_seconds: setup.period_seconds,
            seed,
        });
        // SAFETY: the setup is valid as long as the law, and so are all pointers in it.
        let bytes = unsafe { bytes(&raw const *given) };
        if bytes > BYTES_MAX {
            let reason = format!("canrig_law_bytes wants {bytes} bytes (limit {BYTES_MAX})");
            return Err(Fault::Invalid(reason));
        }
        let mut memory = vec![0; bytes.max(1).div_ceil(size_of::<u128>())];
        let mut why = [0; WHY_BYTES];
        let state = memory.as_mut_ptr().cast();
        // SAFETY: the memory has as many bytes as the law asked for, `why` as many as the header says.
        let status = unsafe { init(state, &raw const *given, why.as_mut_ptr()) };
        if status != 0 {
            why[WHY_BYTES - 1] = 0;
            // SAFETY: it ends with 0 at the latest at its last byte.
            let why = unsafe { CStr::from_ptr(why.as_ptr()) }.to_string_lossy();
            let reason = format!("canrig_law_init returned {status}: {why}");
            return Err(Fault::Invalid(reason));
        }
        Ok(Self {
            step,
            memory,
            setup: given,
            _pointed_to: Box::new((texts, names, [parameter_values, mins, maxs])),
            _library: library,
        })
    }

    /// Calls the law for one cycle.
    ///
    /// # Errors
    /// The law cannot continue.
    ///
    /// # Panics
    /// The number of values differs from the setup.
    pub fn step(
        &mut self,
        time_seconds: f64,
        period_seconds: f64,
        reads: &[f64],
        writes: &mut [f64],
    ) -> Result<(), Fault> {
        let setup = &self.setup;
        let counts = [setup.reads_count, setup.writes_count, setup.terms_count];
        let [read, written, recorded] = counts.map(|count| count as usize);
        let given = (reads.len(), writes.len());
        assert_eq!(given, (read, written + recorded), "the setup's");
        let (writes, terms) = writes.split_at_mut(written);
        let state = self.memory.as_mut_ptr().cast();
        // SAFETY: there are as many values as the law was told.
        let status = unsafe {
            (self.step)(
                state,
                time_seconds,
                period_seconds,
                reads.as_ptr(),
                writes.as_mut_ptr(),
                terms.as_mut_ptr(),
            )
        };
        match status {
            0 => Ok(()),
            status => Err(Fault::Invalid(format!("canrig_law_step returned {status}"))),
        }
    }
}
