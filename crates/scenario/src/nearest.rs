//! Suggestions for unknown names.

/// Smallest similarity (Jaro-Winkler) of a name that is suggested.
const SIMILARITY_MIN: f64 = 0.8;

/// Units that a key may end in, with the factor to the first of their quantity.
const UNITS: [(&str, f64); 22] = [
    ("metres", 1.0),
    ("millimetres", 1e-3),
    ("micrometres", 1e-6),
    ("seconds", 1.0),
    ("milliseconds", 1e-3),
    ("microseconds", 1e-6),
    ("minutes", 60.0),
    ("hours", 3600.0),
    ("amperes", 1.0),
    ("milliamperes", 1e-3),
    ("volts", 1.0),
    ("millivolts", 1e-3),
    ("kilograms", 1.0),
    ("grams", 1e-3),
    ("percent", 1.0),
    ("permille", 0.1),
    ("kilobits", 1.0),
    ("bits", 1e-3),
    ("hertz", 1.0),
    ("kilohertz", 1e3),
    ("newtons", 1.0),
    ("kilonewtons", 1e3),
];

/// Returns the factor from the number of a key to that of a known one, if they differ in one unit only.
#[must_use]
pub(crate) fn unit_factor(key: &str, known: &str) -> Option<f64> {
    let quantity = |at: usize| {
        UNITS[..=at]
            .iter()
            .filter(|(_, factor)| *factor == 1.0)
            .count()
    };
    let unit = |word: &str| UNITS.iter().position(|(name, _)| *name == word);
    let (words, known): (Vec<&str>, Vec<&str>) =
        (key.split('_').collect(), known.split('_').collect());
    let mut different = words
        .iter()
        .zip(&known)
        .filter(|(word, known)| word != known);
    let (word, other) = different.next()?;
    if words.len() != known.len() || different.next().is_some() {
        return None;
    }
    let (from, to) = (unit(word)?, unit(other)?);
    (quantity(from) == quantity(to)).then(|| UNITS[from].1 / UNITS[to].1)
}

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

#[cfg(test)]
mod tests {
    use super::unit_factor;

    #[test]
    fn keys_that_differ_in_a_unit_have_its_factor() {
        let factor = |key, known| unit_factor(key, known).map(f64::round);
        assert_eq!(
            factor("position_metres", "position_millimetres"),
            Some(1000.0)
        );
        assert_eq!(factor("at_minutes", "at_seconds"), Some(60.0));
        assert_eq!(factor("position_metres", "position_seconds"), None);
        assert_eq!(factor("postion_millimetres", "position_millimetres"), None);
        assert_eq!(factor("position_metres", "position_millimetres_max"), None);
    }
}
