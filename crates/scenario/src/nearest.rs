//! Suggestions for unknown names.

use dbc::conversion;

/// Smallest similarity (Jaro-Winkler) of a name that is suggested.
const SIMILARITY_MIN: f64 = 0.8;

/// Units that no port has, each with its size in another one.
const KEY_UNITS: [(&str, f64, &str); 9] = [
    ("milliseconds", 1e-3, "seconds"),
    ("microseconds", 1e-6, "seconds"),
    ("minutes", 60.0, "seconds"),
    ("hours", 3600.0, "seconds"),
    ("millivolts", 1e-3, "volts"),
    ("kilonewtons", 1e3, "newtons"),
    ("kilohertz", 1e3, "hertz"),
    ("permille", 0.1, "percent"),
    ("bits", 1e-3, "kilobits"),
];

/// Returns the factor from the number of a key to that of a known one, if they differ in one unit only.
fn unit_factor(key: &str, known: &str) -> Option<f64> {
    let [words, known] = [key, known].map(|name| Vec::from_iter(name.split('_')));
    let pairs = words.iter().zip(&known);
    let mut different = pairs.filter(|(word, known)| word != known);
    let (word, other) = different.next()?;
    if words.len() != known.len() || different.next().is_some() {
        return None;
    }
    let [(size, unit), (other_size, other_unit)] = [word, other].map(|word| in_unit_of_ports(word));
    Some(size * conversion(unit, other_unit)? / other_size)
}

/// Returns the size of a unit, and the unit in which it is.
fn in_unit_of_ports(word: &str) -> (f64, &str) {
    let found = KEY_UNITS.iter().find(|(name, ..)| *name == word);
    found.map_or((1.0, word), |(_, size, unit)| (*size, unit))
}

/// Returns advice on an unknown name: the known name that was probably meant, else all known names.
pub fn meant_or_known<S: AsRef<str>>(name: &str, known: impl IntoIterator<Item = S>) -> String {
    let all = Vec::from_iter(known);
    let known = Vec::from_iter(all.iter().map(AsRef::as_ref));
    match nearest(name, known.iter().copied()) {
        Some(nearest) => suggestion(name, nearest),
        None => format!("known are: {}", known.join(", ")),
    }
}

/// Returns the question for the name that was probably meant, with the factor if that has another unit.
pub(crate) fn suggestion(name: &str, meant: &str) -> String {
    match unit_factor(name, meant) {
        Some(factor) => format!("did you mean `{meant}`, {factor} times the number?"),
        None => format!("did you mean `{meant}`?"),
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
    use super::{meant_or_known, unit_factor};

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

    #[test]
    fn advice_on_a_key_in_another_unit_says_the_factor() {
        let advice = meant_or_known("duration_minutes", ["duration_seconds", "name"]);
        assert_eq!(
            advice,
            "did you mean `duration_seconds`, 60 times the number?"
        );
    }
}
