//! The release profile of a new crate: that of the checkout, so that both build their dependencies alike and share them.

use std::path::Path;

use toml::{Table, Value};

/// What cargo takes from a workspace's root only, so a crate of its own must have it too.
const HEAD: &str = "\n# As canrig's own, so that a target folder can be shared; canrig's crates are no dependencies there.\n";
/// How canrig's own crates are optimised there, since they are members.
const OPT_LEVEL: i64 = 3;

/// The `[profile.release]` tables for a manifest that depends on a checkout; none where it has no such tables.
///
/// # Errors
/// Why the checkout's manifest cannot be read.
pub(super) fn release_profile(checkout: &Path) -> Result<String, String> {
    let text = std::fs::read_to_string(checkout.join("Cargo.toml"));
    let manifest: Table = text
        .map_err(|error| error.to_string())?
        .parse()
        .map_err(|error: toml::de::Error| error.to_string())?;
    let Some(mut release) =
        table(&manifest, "profile").and_then(|all| table(all, "release").cloned())
    else {
        return Ok(String::new());
    };
    if let Some(Value::Table(packages)) = release.get_mut("package") {
        for member in members(&manifest) {
            let level = Table::from_iter([("opt-level".to_owned(), Value::Integer(OPT_LEVEL))]);
            packages.entry(member).or_insert(Value::Table(level));
        }
    }
    let profile = Table::from_iter([("release".to_owned(), Value::Table(release))]);
    let tables = Table::from_iter([("profile".to_owned(), Value::Table(profile))]);
    let tables = toml::to_string(&tables).map_err(|error| error.to_string())?;
    Ok(format!("{HEAD}{tables}"))
}

fn table<'a>(parent: &'a Table, key: &str) -> Option<&'a Table> {
    parent.get(key)?.as_table()
}

/// The names of canrig's own crates, which are those of their folders.
fn members(manifest: &Table) -> impl Iterator<Item = String> {
    let workspace = table(manifest, "workspace");
    let members = workspace.and_then(|workspace| workspace.get("members")?.as_array());
    let paths = members.into_iter().flatten().filter_map(Value::as_str);
    paths.map(|path| path.rsplit('/').next().unwrap_or(path).to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dependencies_are_built_as_in_the_checkout_and_its_crates_optimised() {
        let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let ours: Table = release_profile(&checkout).unwrap().parse().unwrap();
        let root = std::fs::read_to_string(checkout.join("Cargo.toml")).unwrap();
        let root: Table = root.parse().unwrap();
        let mut ours = ours["profile"]["release"].clone();
        let packages = ours["package"].as_table_mut().unwrap();
        for member in members(&root) {
            let level = packages.remove(&member);
            assert_eq!(
                level.unwrap()["opt-level"].as_integer(),
                Some(3),
                "{member}"
            );
        }
        assert_eq!(ours, root["profile"]["release"]);
    }
}
