//! Plants as FMUs: the description of a model, and the C functions of FMI 2.0 and 3.0 around it.
//!
//! A model is a type that is [`Exported`]. The program writes its FMU ([`write_fmu`]): a description, and a shared
//! library with the C functions and the model. Such a library is a crate of type `cdylib` that names its models in
//! [`export!`](crate::export!).

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

/// A model that becomes an FMU.
pub trait Exported: Send + Sync {
    /// Returns the name of the model.
    fn name(&self) -> &str;

    /// Returns the description of the model.
    ///
    /// # Errors
    /// The model has none, such as with invalid defaults; the error is the reason.
    fn model(&self) -> Result<Model, String>;

    /// Starts an instance, with the values of the parameters in their order.
    ///
    /// # Errors
    /// The parameters are invalid; the error is the reason.
    fn start(&self, parameters: &[StartValue]) -> Result<Box<dyn Running>, String>;
}

/// An instance that runs.
pub trait Running {
    /// Advances the time under constant inputs, in the order of the model's.
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]);

    /// Returns the outputs now, in the order of the model's.
    fn outputs(&self) -> Vec<f64>;
}

/// A model, for its description.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Name of the model and of its library: letters, digits and underscores.
    pub name: String,
    /// Description of the model.
    pub description: String,
    /// Version of the model.
    pub version: String,
    /// Variables. Inputs, parameters and outputs may have any order.
    pub variables: Vec<ModelVariable>,
}

/// A variable of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelVariable {
    /// Name of the variable.
    pub name: String,
    /// Description of the variable.
    pub description: String,
    /// Unit, by the symbols of [`crate::unit::KNOWN`]; empty for none.
    pub unit: &'static str,
    /// Role of the variable.
    pub role: Role,
}

/// Role of a variable.
#[derive(Clone, Debug, PartialEq)]
pub enum Role {
    /// An input, with its value before the first one is set.
    Input(f64),
    /// A parameter that is a number, fixed at the start.
    Number {
        /// Default value.
        start: f64,
        /// Lowest value.
        min: Option<f64>,
        /// Highest value.
        max: Option<f64>,
    },
    /// A parameter that is one of several texts, fixed at the start.
    Word {
        /// Default value.
        start: String,
    },
    /// A computed value.
    Output,
}

impl Role {
    /// Returns the default value of a parameter; `None` for other variables.
    pub fn start(&self) -> Option<StartValue> {
        match self {
            Self::Number { start, .. } => Some(StartValue::Number(*start)),
            Self::Word { start } => Some(StartValue::Text(start.clone())),
            Self::Input(_) | Self::Output => None,
        }
    }
}

impl Model {
    /// Returns the token by which a library recognises its own description. It changes with every property of the
    /// variables in the description.
    pub fn token(&self) -> String {
        let mut hasher = DefaultHasher::new();
        format!("{self:?}").hash(&mut hasher);
        format!("{}-{}-{:016x}", self.name, self.version, hasher.finish())
    }

    /// Returns the `modelDescription.xml`.
    pub fn description_xml(&self, version: Version) -> String {
        describe::xml(self, version)
    }
}

/// Writes the FMU of a model for this machine. `library` has the bytes of the shared library with the model. The file
/// is made in memory, since a writer of zip files that is left unfinished, as on a full disk, prints on standard error.
///
/// # Errors
/// The output cannot be written.
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

/// Function that makes the models of a library.
type Models = fn() -> Vec<Box<dyn Exported>>;

static REGISTERED: OnceLock<Models> = OnceLock::new();

static MODELS: LazyLock<Vec<Box<dyn Exported>>> =
    LazyLock::new(|| REGISTERED.get().map_or_else(Vec::new, |models| models()));

/// Registers the models of this library for the C functions. [`export!`](crate::export!) calls it.
pub fn register(models: Models) {
    let _ = REGISTERED.set(models);
}

/// Returns the model whose description has this token.
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
            // The system calls this when it loads the library. The call only keeps the address of the function.
            #[used]
            #[unsafe(link_section = ".init_array")]
            static REGISTER: extern "C" fn() = register;
        };
    };
}

#[cfg(test)]
mod tests;
