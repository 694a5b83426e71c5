//! The name that was probably meant.

/// A name is near enough to be suggested from this similarity (Jaro-Winkler) on.
const SIMILARITY_MIN: f64 = 0.8;

/// What to say of a name that is not known: the one that was probably meant, else all that are.
#[must_use]
pub fn meant_or_known(name: &str, known: &[&str]) -> String {
    match nearest(name, known.iter().copied()) {
        Some(nearest) => format!("did you mean `{nearest}`?"),
        None => format!("known are: {}", known.join(", ")),
    }
}

/// The known name that is most like a given one, if any is like it, whatever is written large.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let name = name.to_lowercase();
    let similar = known
        .into_iter()
        .map(|known| (strsim::jaro_winkler(&name, &known.to_lowercase()), known))
        .filter(|(similarity, _)| *similarity >= SIMILARITY_MIN);
    let nearest = similar.max_by(|left, right| left.0.total_cmp(&right.0));
    nearest.map(|(_, known)| known)
}
