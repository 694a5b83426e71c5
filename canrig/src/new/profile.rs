//! The release profile of a new crate. It equals the checkout's, so both build their dependencies alike and share them.

use std::path::Path;

use toml::{Table, Value};

/// Heading of the profile tables. Cargo reads them from the root of a workspace only, so a new crate needs its own.
const HEAD: &str = "\n# As canrig's own, so that a target folder can be shared.\n";

/// Largest size of a manifest.
pub(super) const MANIFEST_BYTES_MAX: u64 = 1 << 20;

/// Returns the `[profile.release]` tables for a manifest that depends on a checkout. The text is empty if the checkout
/// has none.
///
/// # Errors
/// The checkout's manifest cannot be read.
pub(super) fn release_profile(checkout: &Path) -> Result<String, String> {
    let text = scenario::read_text(&checkout.join("Cargo.toml"), MANIFEST_BYTES_MAX);
    let mut manifest: Table = text
        .map_err(|error| error.to_string())?
        .parse()
        .map_err(|error: toml::de::Error| error.to_string())?;
    manifest.retain(|key, _| key == "profile");
    let Some(Value::Table(profiles)) = manifest.get_mut("profile") else {
        return Ok(String::new());
    };
    profiles.retain(|name, _| name == "release");
    if profiles.is_empty() {
        return Ok(String::new());
    }
    let tables = toml::to_string(&manifest).map_err(|error| error.to_string())?;
    Ok(format!("{HEAD}{tables}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dependencies_are_built_as_in_the_checkout_and_its_crates_optimised() {
        let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let ours: Table = release_profile(&checkout).unwrap().parse().unwrap();
        let root: Table = std::fs::read_to_string(checkout.join("Cargo.toml"))
            .unwrap()
            .parse()
            .unwrap();
        let packages = ours["profile"]["release"]["package"].as_table().unwrap();
        // A crate of its own is another workspace, in which canrig's crates are dependencies.
        for member in ["controller", "plant-emulator", "worlds"] {
            let level = packages[member]["opt-level"].as_integer();
            assert_eq!(level, Some(3), "{member}");
        }
        assert_eq!(ours["profile"]["release"], root["profile"]["release"]);
    }
}
