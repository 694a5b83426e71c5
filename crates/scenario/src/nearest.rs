//! Suggestions for unknown names.

/// Smallest similarity (Jaro-Winkler) of a name that is suggested.
const SIMILARITY_MIN: f64 = 0.8;

/// Returns advice on an unknown name: the known name that was probably meant, else all known names.
#[must_use]
pub fn meant_or_known(name: &str, known: &[&str]) -> String {
    match nearest(name, known.iter().copied()) {
        Some(nearest) => format!("did you mean `{nearest}`?"),
        None => format!("known are: {}", known.join(", ")),
    }
}

/// Returns the known name that is most similar to a given one, if one is similar enough; upper and lower case count as equal.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let name = name.to_lowercase();
    let similar = known
        .into_iter()
        .map(|known| (strsim::jaro_winkler(&name, &known.to_lowercase()), known))
        .filter(|(similarity, _)| *similarity >= SIMILARITY_MIN);
    let nearest = similar.max_by(|left, right| left.0.total_cmp(&right.0));
    nearest.map(|(_, known)| known)
}
