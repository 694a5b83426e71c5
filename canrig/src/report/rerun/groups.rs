//! Which signals are drawn together, and how.

/// How a signal is drawn.
#[derive(Clone, Copy)]
pub(super) struct Style {
    /// The first part of its path; a view shows a whole group.
    pub(super) group: &'static str,
    /// Its name in the legend.
    pub(super) label: &'static str,
    /// Its colour.
    pub(super) colour: [u8; 3],
    is_drawn_when_zero: bool,
}

/// The group of signals that no view shows.
pub(super) const OTHER: &str = "other";

// Colours that people with any colour vision tell apart (Okabe and Ito), light enough for a dark viewer.
const ORANGE: [u8; 3] = [230, 159, 0];
const SKY: [u8; 3] = [86, 180, 233];
const GREEN: [u8; 3] = [0, 158, 115];
const PINK: [u8; 3] = [204, 121, 167];
const YELLOW: [u8; 3] = [240, 228, 66];
pub(super) const GREY: [u8; 3] = [128, 128, 128];

/// Signals by the beginning of their names.
const STYLES: [(&str, Style); 18] = [
    ("set_point_", always("position", "set-point", ORANGE)),
    ("position_", always("position", "measured", SKY)),
    ("true_position_", always("position", "true", GREEN)),
    (
        "reference_position_",
        if_used("position", "filtered reference", PINK),
    ),
    (
        "error_millimetres",
        always("error", "set-point − measured", SKY),
    ),
    ("target_current_", always("current", "commanded", ORANGE)),
    ("current_", always("current", "measured", SKY)),
    ("wire_temperature_", always("temperature", "true", GREEN)),
    (
        "estimated_temperature_",
        if_used("temperature", "estimated", PINK),
    ),
    (
        "martensite_fraction",
        always("martensite_fraction", "true", GREEN),
    ),
    (
        "estimated_martensite_fraction",
        if_used("martensite_fraction", "estimated", PINK),
    ),
    (
        "sliding_variable",
        if_used("sliding_variable", "sliding variable", SKY),
    ),
    (
        "equivalent_part_",
        if_used("law", "equivalent part", ORANGE),
    ),
    ("switching_part_", if_used("law", "switching part", SKY)),
    (
        "scenario_convection_factor",
        if_used("disturbance", "convection factor, scenario", GREY),
    ),
    (
        "convection_factor",
        if_used("disturbance", "convection factor, bus", YELLOW),
    ),
    (
        "scenario_added_load_",
        if_used("disturbance", "added load (g), scenario", GREY),
    ),
    (
        "added_load_",
        if_used("disturbance", "added load (g), bus", ORANGE),
    ),
];

const fn always(group: &'static str, label: &'static str, colour: [u8; 3]) -> Style {
    Style {
        group,
        label,
        colour,
        is_drawn_when_zero: true,
    }
}

/// Nodes send 0 for what they do not have: a law without an observer has no estimates.
const fn if_used(group: &'static str, label: &'static str, colour: [u8; 3]) -> Style {
    Style {
        group,
        label,
        colour,
        is_drawn_when_zero: false,
    }
}

/// The style of a signal; those that no view shows are in the group [`OTHER`].
pub(super) fn style(name: &str, values: &[f64]) -> Style {
    let is_used = || values.iter().any(|value| value.abs() > 0.0);
    let known = STYLES.iter().find(|(start, _)| name.starts_with(start));
    let drawn = known.filter(|(_, style)| style.is_drawn_when_zero || is_used());
    drawn.map_or(always(OTHER, "", GREY), |(_, style)| *style)
}
