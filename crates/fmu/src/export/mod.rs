//! Plants as FMUs: what describes one, and the C functions of FMI 2.0 and 3.0 round it.
//!
//! A model is anything that is [`Exported`]. The program writes its FMU ([`write_fmu`]): a description, and a shared library that has the
//! C functions and knows the model. Such a library is a crate of type `cdylib` that [`export!`](crate::export!) names its models in.

mod component;
mod describe;
mod played;
mod three;
mod two;

use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{Cursor, Write};
use std::sync::{LazyLock, OnceLock};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::archive::DESCRIPTION;
use crate::description::Version;
use crate::instance::StartValue;

/// Something that becomes an FMU.
pub trait Exported: Send + Sync {
    /// The name of its model.
    fn name(&self) -> &str;

    /// What it is.
    ///
    /// # Errors
    /// Why there is none, such as defaults that make no sense, in words.
    fn model(&self) -> Result<Model, String>;

    /// Starts one, with the values of its parameters in their order.
    ///
    /// # Errors
    /// Why the parameters make no sense, in words.
    fn start(&self, parameters: &[StartValue]) -> Result<Box<dyn Running>, String>;
}

/// One that runs.
pub trait Running {
    /// Lets time pass under constant inputs, in the order of the model's.
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]);

    /// Its outputs now, in the order of the model's.
    fn outputs(&self) -> Vec<f64>;
}

/// What a model is, for its description.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Its name, and that of its library: letters, digits and underscores.
    pub name: String,
    /// What it is.
    pub description: String,
    /// Its version.
    pub version: String,
    /// Its variables. Inputs, parameters and outputs may stand in any order.
    pub variables: Vec<ModelVariable>,
}

/// A variable of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelVariable {
    /// Its name.
    pub name: String,
    /// What it is.
    pub description: String,
    /// Its unit, by the symbols of [`crate::unit::KNOWN`]; empty for none.
    pub unit: &'static str,
    /// What it is for.
    pub role: Role,
}

/// What a variable is for.
#[derive(Clone, Debug, PartialEq)]
pub enum Role {
    /// Set from outside, with the value that it has until then.
    Input(f64),
    /// Fixed at the start: a number, with its limits.
    Number {
        /// What it is by default.
        start: f64,
        /// Lowest value.
        min: Option<f64>,
        /// Highest value.
        max: Option<f64>,
    },
    /// Fixed at the start: one of several words.
    Word {
        /// What it is by default.
        start: String,
    },
    /// Computed.
    Output,
}

impl Role {
    /// The value that a parameter has by default; none of what is no parameter.
    #[must_use]
    pub fn start(&self) -> Option<StartValue> {
        match self {
            Self::Number { start, .. } => Some(StartValue::Number(*start)),
            Self::Word { start } => Some(StartValue::Text(start.clone())),
            Self::Input(_) | Self::Output => None,
        }
    }
}

impl Model {
    /// By what a library knows that a description is its own: it changes with anything that the description says of the variables.
    #[must_use]
    pub fn token(&self) -> String {
        let mut hasher = DefaultHasher::new();
        format!("{self:?}").hash(&mut hasher);
        format!("{}-{}-{:016x}", self.name, self.version, hasher.finish())
    }

    /// Its `modelDescription.xml`.
    #[must_use]
    pub fn description_xml(&self, version: Version) -> String {
        describe::xml(self, version)
    }
}

/// Writes the FMU of a model for this machine; `library` are the bytes of the shared library that knows it. It is made in memory,
/// since a writer of zip files that is left unfinished, as on a full disk, prints on standard error.
///
/// # Errors
/// It cannot be written.
pub fn write_fmu(
    mut output: impl Write,
    model: &Model,
    version: Version,
    library: &[u8],
) -> std::io::Result<()> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
    zip.start_file(DESCRIPTION, options)?;
    zip.write_all(model.description_xml(version).as_bytes())?;
    let path = format!("binaries/{}/{}.so", version.platform(), model.name);
    zip.start_file(path, options.unix_permissions(0o755))?;
    zip.write_all(library)?;
    output.write_all(&zip.finish()?.into_inner())
}

/// Makes the models of a library.
type Models = fn() -> Vec<Box<dyn Exported>>;

static REGISTERED: OnceLock<Models> = OnceLock::new();

static MODELS: LazyLock<Vec<Box<dyn Exported>>> =
    LazyLock::new(|| REGISTERED.get().map_or_else(Vec::new, |models| models()));

/// Says which models the C functions of this library have. [`export!`](crate::export!) calls it.
pub fn register(models: Models) {
    let _ = REGISTERED.set(models);
}

/// The model whose description has this token.
fn by_token(token: &str) -> Option<(&'static dyn Exported, Model)> {
    MODELS.iter().find_map(|exported| {
        let model = exported.model().ok()?;
        (model.token() == token).then_some((&**exported, model))
    })
}

/// Makes a `cdylib` a library of FMUs: `fmu::export!(models)`, with a function that makes the models.
#[macro_export]
macro_rules! export {
    ($models:path) => {
        const _: () = {
            extern "C" fn register() {
                $crate::export::register($models);
            }
            // Called when the library is loaded. It only keeps the address of the function.
            #[used]
            #[unsafe(link_section = ".init_array")]
            static REGISTER: extern "C" fn() = register;
        };
    };
}

#[cfg(test)]
mod tests;
