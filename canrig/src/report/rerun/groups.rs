//! Which signals are drawn together, and how.

/// How a signal is drawn.
pub(super) struct Style {
    /// The first part of its path; a view shows a whole group.
    pub(super) group: &'static str,
    /// Its name in the legend.
    pub(super) label: &'static str,
    /// Its colour.
    pub(super) colour: [u8; 3],
}

// Colours that people with any colour vision tell apart (Okabe and Ito), light enough for a dark viewer.
const ORANGE: [u8; 3] = [230, 159, 0];
const SKY: [u8; 3] = [86, 180, 233];
const GREEN: [u8; 3] = [0, 158, 115];
const PINK: [u8; 3] = [204, 121, 167];
const YELLOW: [u8; 3] = [240, 228, 66];
pub(super) const GREY: [u8; 3] = [128, 128, 128];

/// Signals by the beginning of their names.
const STYLES: [(&str, Style); 16] = [
    ("set_point_", style_of("position", "set-point", ORANGE)),
    ("position_", style_of("position", "measured", SKY)),
    ("true_position_", style_of("position", "true", GREEN)),
    (
        "reference_position_",
        style_of("position", "filtered reference", PINK),
    ),
    (
        "error_millimetres",
        style_of("error", "set-point − measured", SKY),
    ),
    ("target_current_", style_of("current", "commanded", ORANGE)),
    ("current_", style_of("current", "measured", SKY)),
    ("wire_temperature_", style_of("temperature", "true", GREEN)),
    (
        "estimated_temperature_",
        style_of("temperature", "estimated", PINK),
    ),
    (
        "martensite_fraction",
        style_of("martensite_fraction", "true", GREEN),
    ),
    (
        "estimated_martensite_fraction",
        style_of("martensite_fraction", "estimated", PINK),
    ),
    (
        "sliding_variable",
        style_of("sliding_variable", "sliding variable", SKY),
    ),
    (
        "equivalent_part_",
        style_of("law", "equivalent part", ORANGE),
    ),
    ("switching_part_", style_of("law", "switching part", SKY)),
    (
        "convection_factor",
        style_of("disturbance", "convection factor", YELLOW),
    ),
    (
        "added_load_",
        style_of("disturbance", "added load (g)", ORANGE),
    ),
];

const fn style_of(group: &'static str, label: &'static str, colour: [u8; 3]) -> Style {
    Style {
        group,
        label,
        colour,
    }
}

/// The style of a signal; those that no view shows are in the group `other`.
pub(super) fn style(name: &str) -> Style {
    let known = STYLES.iter().find(|(start, _)| name.starts_with(start));
    known.map_or(
        style_of("other", "", GREY),
        |(
            _,
            Style {
                group,
                label,
                colour,
            },
        )| Style {
            group,
            label,
            colour: *colour,
        },
    )
}
