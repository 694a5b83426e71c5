//! The file of an FMU: a zip file from an untrusted source.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use zip::ZipArchive;
use zip::read::ZipFile;

use crate::description::{BYTES_MAX, Description, Version};
use crate::error::{Fault, FmuError};
use crate::folder::Folder;

/// Name of the description in the zip file and in the folder.
pub const DESCRIPTION: &str = "modelDescription.xml";
/// Largest size of the file.
const FILE_BYTES_MAX: u64 = 1 << 30;
/// Largest number of files in it.
const FILES_MAX: usize = 20_000;
/// Largest size of its unpacked files together.
const UNPACKED_BYTES_MAX: u64 = 2 << 30;

/// The file of an FMU, with its description.
pub struct Archive {
    /// Path of the file.
    pub file: PathBuf,
    /// The description.
    pub description: Description,
    /// Folders below `binaries`: the platforms with a library.
    pub platforms: Vec<String>,
}

/// An unpacked FMU. Its files are removed when this is dropped.
#[derive(Debug)]
pub struct Unpacked {
    folder: Folder,
    /// Path of the FMU's file.
    pub file: PathBuf,
}

impl Archive {
    /// Opens a file and reads its description. It unpacks no other file and runs no code.
    ///
    /// # Errors
    /// The file cannot be read, is no acceptable zip file, or its description is invalid.
    pub fn open(file: &Path) -> Result<Self, FmuError> {
        let read = opened(file).and_then(read);
        let (description, platforms) = read.map_err(|fault| fault.of(file))?;
        Ok(Self {
            file: file.to_owned(),
            description,
            platforms,
        })
    }

    /// Checks whether there is a library for this machine.
    ///
    /// # Errors
    /// There is none.
    pub fn runs_here(&self) -> Result<(), Fault> {
        let platform = self.description.version.platform();
        if self.platforms.iter().any(|found| found == platform) {
            return Ok(());
        }
        let found = match &self.platforms[..] {
            [] => "none".to_owned(),
            platforms => platforms.join(", "),
        };
        Err(Fault::Invalid(format!(
            "it has no library for this machine ({platform}); it has {found}"
        )))
    }

    /// Unpacks the files for this machine into a new folder.
    ///
    /// # Errors
    /// There is no library for this machine, or the FMU cannot be unpacked.
    pub fn unpack(&self) -> Result<Unpacked, FmuError> {
        let unpacked = || {
            self.description.served()?;
            self.runs_here()?;
            let folder = Folder::new().map_err(|source| at("a folder to unpack it to", source))?;
            let platform = self.description.version.platform();
            unpack_to(opened(&self.file)?, folder.path(), platform)?;
            Ok(folder)
        };
        let folder = unpacked().map_err(|fault: Fault| fault.of(&self.file))?;
        Ok(Unpacked {
            folder,
            file: self.file.clone(),
        })
    }
}

impl Unpacked {
    /// Returns the folder of the unpacked files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }
}

/// Reads the description and the platforms of a zip file.
///
/// # Errors
/// The file is no acceptable zip file, or its description is invalid.
pub fn read(bytes: impl Read + io::Seek) -> Result<(Description, Vec<String>), Fault> {
    let mut zip = open_zip(bytes)?;
    let names = zip.file_names().filter_map(|name| {
        let name = name.ok()?;
        let (platform, library) = name.strip_prefix("binaries/")?.split_once('/')?;
        (!library.is_empty()).then(|| platform.to_owned())
    });
    let mut platforms = Vec::from_iter(names);
    platforms.sort();
    platforms.dedup();
    let entry = zip.by_name(DESCRIPTION).map_err(|error| {
        Fault::Invalid(format!("it has no {DESCRIPTION} that can be read: {error}"))
    })?;
    let description = Description::parse(&limited_text(entry)?)?;
    Ok((description, platforms))
}

/// Unpacks everything that a library of FMI 2.0 on `platform` needs, as [`Archive::unpack`] does.
///
/// # Errors
/// The file is no acceptable zip file, or the folder cannot be written.
pub fn unpack_to(bytes: impl Read + io::Seek, folder: &Path, platform: &str) -> Result<(), Fault> {
    let mut zip = open_zip(bytes)?;
    let binaries = Path::new("binaries").join(platform);
    let mut left = UNPACKED_BYTES_MAX;
    // FMI 2.0 gets the path of this folder even if it is empty.
    fs::create_dir_all(folder.join("resources")).map_err(|source| at("resources", source))?;
    for index in 0..zip.len() {
        let mut entry = entry(&mut zip, index)?;
        let Some(path) = safe_path(&entry) else {
            continue;
        };
        let is_needed = path == Path::new(DESCRIPTION)
            || path.starts_with("resources")
            || path.starts_with(&binaries);
        if !is_needed {
            continue;
        }
        let target = folder.join(&path);
        let at_path = |source| at(&path.display().to_string(), source);
        if entry.is_dir() {
            fs::create_dir_all(&target).map_err(at_path)?;
            continue;
        }
        if let Some(parent) = target.parent() {
            fs::create_dir_all(parent).map_err(at_path)?;
        }
        let mut output = File::create(&target).map_err(at_path)?;
        let written = io::copy(&mut (&mut entry).take(left), &mut output).map_err(at_path)?;
        left -= written;
        if left == 0 {
            return Err(Fault::Invalid(format!(
                "it unpacks to more than {UNPACKED_BYTES_MAX} bytes"
            )));
        }
    }
    Ok(())
}

/// Reads the description of an unpacked FMU.
pub(crate) fn description_in(folder: &Path) -> Result<Description, Fault> {
    let path = folder.join(DESCRIPTION);
    let file = File::open(path).map_err(|source| at(DESCRIPTION, source))?;
    Description::parse(&limited_text(file)?)
}

fn at(place: &str, source: io::Error) -> Fault {
    Fault::File {
        place: place.to_owned(),
        source,
    }
}

fn opened(path: &Path) -> Result<File, Fault> {
    let unread = |source| at("cannot be opened", source);
    let file = scenario::open_file(path).map_err(unread)?;
    let bytes = file.metadata().map_err(unread)?.len();
    if bytes > FILE_BYTES_MAX {
        return Err(Fault::Invalid(format!(
            "it has {bytes} bytes (limit {FILE_BYTES_MAX})"
        )));
    }
    Ok(file)
}

/// Opens a zip file, and checks that its entries stay in their folder and are not too many or too large.
fn open_zip<R: Read + io::Seek>(bytes: R) -> Result<ZipArchive<R>, Fault> {
    let mut zip = ZipArchive::new(bytes)
        .map_err(|error| Fault::Invalid(format!("not a zip file that can be read: {error}")))?;
    if zip.len() > FILES_MAX {
        return Err(Fault::Invalid(format!(
            "it has {} files in it (limit {FILES_MAX})",
            zip.len()
        )));
    }
    let mut bytes_in_all = 0_u64;
    for index in 0..zip.len() {
        let entry = entry(&mut zip, index)?;
        let is_safe = safe_path(&entry).is_some();
        if !is_safe || entry.is_symlink() {
            let name = String::from_utf8_lossy(entry.name_raw());
            let problem = if is_safe {
                "is a link"
            } else {
                "leads out of its folder"
            };
            return Err(Fault::Invalid(format!("its entry {name:?} {problem}")));
        }
        bytes_in_all = bytes_in_all.saturating_add(entry.size());
    }
    if bytes_in_all > UNPACKED_BYTES_MAX {
        return Err(Fault::Invalid(format!(
            "it unpacks to {bytes_in_all} bytes (limit {UNPACKED_BYTES_MAX})"
        )));
    }
    Ok(zip)
}

fn entry<R: Read + io::Seek>(
    zip: &mut ZipArchive<R>,
    index: usize,
) -> Result<ZipFile<'_, R>, Fault> {
    zip.by_index(index)
        .map_err(|error| Fault::Invalid(format!("its entry {index} cannot be read: {error}")))
}

/// Returns the path of an entry below its folder; `None` for one that leads out of it.
fn safe_path<R: Read>(entry: &ZipFile<'_, R>) -> Option<PathBuf> {
    let name = entry.name().ok()?;
    if name.contains(['\\', '\0']) {
        return None;
    }
    let path = Path::new(&*name);
    let stays = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    path.components().all(stays).then(|| path.to_owned())
}

/// Reads the text of a description. The limit does not rely on the length that the zip file states.
fn limited_text(bytes: impl Read) -> Result<String, Fault> {
    let mut text = Vec::new();
    bytes
        .take(BYTES_MAX + 1)
        .read_to_end(&mut text)
        .map_err(|source| at(DESCRIPTION, source))?;
    if text.len() as u64 > BYTES_MAX {
        return Err(Fault::xml(format!("it has more than {BYTES_MAX} bytes")));
    }
    String::from_utf8(text).map_err(|_| Fault::xml("it is not text in UTF-8"))
}

/// Finds the library of an unpacked FMU.
pub(crate) fn library_in(folder: &Path, description: &Description) -> Result<PathBuf, Fault> {
    let identifier = &description.served()?.model_identifier;
    let platform = description.version.platform();
    let name = format!("binaries/{platform}/{identifier}.so");
    let path = Some(folder.join(&name)).filter(|path| path.is_file());
    path.ok_or_else(|| Fault::library(format!("there is no {name} in it")))
}

/// Returns the folder of resources in the form that the version requires: a URI, or a path.
pub(crate) fn resources_in(folder: &Path, version: Version) -> String {
    let folder = folder.join("resources");
    let path = folder.to_string_lossy();
    match version {
        Version::Two => {
            let is_plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"/-_.~".contains(byte);
            let escaped = path.bytes().map(|byte| {
                if is_plain(&byte) {
                    char::from(byte).to_string()
                } else {
                    format!("%{byte:02X}")
                }
            });
            format!("file://{}", String::from_iter(escaped))
        }
        Version::Three => format!("{path}/"),
    }
}

#[cfg(test)]
mod tests;
