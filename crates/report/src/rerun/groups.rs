//! Groups of signals that are drawn together, and their styles.

use re_sdk_types::archetypes::SeriesLines;
use re_sdk_types::components::InterpolationMode;
use std::collections::BTreeSet;

use dbc::{Database, Quantities};

use crate::{shown_unit, title};
use plan::{ControlLoop, Plan};

/// Style of a signal.
#[derive(Clone, Copy)]
pub(super) struct Style<'a> {
    /// First part of the path; a view shows a whole group.
    pub(super) group: &'a str,
    /// Name in the legend.
    pub(super) label: &'a str,
    pub(super) colour: [u8; 3],
}

/// Groups with the names of the measured signal and of the output of the amplifier.
const MEASURED: &str = "{signal}";
const COMMANDED: &str = "{command}";
/// Group of signals that no view shows.
pub(super) const OTHER: &str = "other";
/// Group of the times of each cycle, from the stamps.
pub(super) const TIMING: &str = "timing";
/// Groups that only some runs have.
pub(super) const DISTURBANCE: &str = "disturbance";
pub(super) const SLIDING_VARIABLE: &str = "sliding_variable";
pub(super) const LAW: &str = "law";
pub(super) const MOTOR_SPEED: &str = "motor_speed";
pub(super) const SPRING_FORCE: &str = "spring_force";
/// Group of the hysteresis of fraction over temperature.
pub(super) const HYSTERESIS: &str = "hysteresis";

// Colours that people with any colour vision distinguish (Okabe and Ito), light enough for a dark viewer.
pub(super) const ORANGE: [u8; 3] = [230, 159, 0];
pub(super) const SKY: [u8; 3] = [86, 180, 233];
pub(super) const GREEN: [u8; 3] = [0, 158, 115];
pub(super) const PINK: [u8; 3] = [204, 121, 167];
const YELLOW: [u8; 3] = [240, 228, 66];
pub(super) const GREY: [u8; 3] = [128, 128, 128];

/// Styles of signals, by the beginnings of their names or of the patterns of these.
const STYLES: [(&str, Style<'static>); 21] = [
    ("set_point_", look(MEASURED, "set-point", ORANGE)),
    ("{signal}_", look(MEASURED, "measured", SKY)),
    ("true_{signal}_", look(MEASURED, "true", GREEN)),
    (
        "reference_{signal}_",
        look(MEASURED, "filtered reference", PINK),
    ),
    ("error_", look("error", "set-point − measured", SKY)),
    ("target_{command}_", look(COMMANDED, "commanded", ORANGE)),
    ("{command}_", look(COMMANDED, "measured", SKY)),
    ("wire_temperature_", look("temperature", "true", GREEN)),
    ("winding_temperature_", look("temperature", "true", GREEN)),
    ("motor_speed_", look(MOTOR_SPEED, "true", GREEN)),
    ("spring_force_", look(SPRING_FORCE, "true", GREEN)),
    (
        "estimated_temperature_",
        look("temperature", "estimated", PINK),
    ),
    (
        "martensite_fraction",
        look("martensite_fraction", "true", GREEN),
    ),
    (
        "estimated_martensite_fraction",
        look("martensite_fraction", "estimated", PINK),
    ),
    (
        "sliding_variable",
        look(SLIDING_VARIABLE, "sliding variable", SKY),
    ),
    ("equivalent_part_", look(LAW, "equivalent part", ORANGE)),
    ("switching_part_", look(LAW, "switching part", SKY)),
    (
        "scenario_convection_factor",
        look(DISTURBANCE, "convection factor, scenario", GREY),
    ),
    (
        "convection_factor",
        look(DISTURBANCE, "convection factor, bus", YELLOW),
    ),
    (
        "scenario_added_load_",
        look(DISTURBANCE, "added load (g), scenario", GREY),
    ),
    (
        "added_load_",
        look(DISTURBANCE, "added load (g), bus", ORANGE),
    ),
];

const fn look<'a>(group: &'a str, label: &'a str, colour: [u8; 3]) -> Style<'a> {
    Style {
        group,
        label,
        colour,
    }
}

/// Signal of a plant or a law with a separate group and view, since no other view draws it.
pub(super) struct CustomView<'a> {
    pub(super) title: String,
    pub(super) style: Style<'a>,
}

/// Returns the signals of a scenario's plant and law that need separate views.
pub(super) fn custom_views<'a>(
    plan: &'a Plan,
    control_loop: &'a ControlLoop,
) -> Vec<CustomView<'a>> {
    let trial = &control_loop.trial;
    let quantities = &trial.wiring.quantities;
    let is_measured = |style: Style<'_>| style.group == quantities.feedback.name;
    let has_view = |name: &str| known(name, quantities).is_some_and(|style| !is_measured(style));
    let signals = control_loop
        .plant_signals(plan.database())
        // A position that the loop does not follow is no second line next to the loop's own.
        .filter(|it| trial.plant().custom.is_some() || !has_view(&it.name))
        .map(|it| (it, "true", GREEN));
    let terms = control_loop
        .terms(plan.database())
        .filter(|_| trial.controller.is_from_outside())
        .map(|it| (it, "law", PINK));
    let shipped = Database::shipped();
    // A signal with the name of a shipped one is drawn with it.
    let drawn = signals
        .chain(terms)
        .filter(|(it, ..)| !shipped.has_signal(&it.name));
    let view = drawn.map(|(signal, label, colour)| {
        let title = title(signal);
        CustomView {
            title: match shown_unit(&signal.unit) {
                "" => title.to_owned(),
                unit => format!("{title} ({unit})"),
            },
            style: look(&signal.name, label, colour),
        }
    });
    view.collect()
}

fn known<'a>(name: &str, quantities: &'a Quantities) -> Option<Style<'a>> {
    let is_start = |start: &str| name.starts_with(&quantities.name(start));
    let known = STYLES.iter().find(|(start, _)| is_start(start));
    known.map(|(_, style)| Style {
        group: match style.group {
            MEASURED => &quantities.feedback.name,
            COMMANDED => &quantities.output.name,
            group => group,
        },
        ..*style
    })
}

/// Returns the style of a signal; signals that no view shows are in the group [`OTHER`], as are outputs of an io node that the
/// scenario does not disturb.
pub(super) fn style<'a>(
    name: &str,
    quantities: &'a Quantities,
    disturbed: &[String],
    views: &[CustomView<'a>],
) -> Style<'a> {
    if let Some(view) = views.iter().find(|view| view.style.group == name) {
        return view.style;
    }
    let is_disturbed = || disturbed.iter().any(|output| name.ends_with(output));
    let drawn =
        known(name, quantities).filter(|style| style.group != DISTURBANCE || is_disturbed());
    drawn.unwrap_or(look(OTHER, "", GREY))
}

/// Returns the groups that a run will have, before its first frame.
pub(super) fn expected<'a>(plan: &'a Plan, control_loop: &'a ControlLoop) -> BTreeSet<&'a str> {
    let scenario = &control_loop.trial;
    let mut groups = BTreeSet::new();
    if !scenario.reference.is_empty() {
        groups.insert("error");
    }
    let views = custom_views(plan, control_loop);
    let signals = control_loop.plant_signals(plan.database());
    let quantities = &scenario.wiring.quantities;
    groups.extend(signals.map(|signal| style(&signal.name, quantities, &[], &views).group));
    groups.extend(views.iter().map(|view| view.style.group));
    if scenario.plant().actuator().is_some() {
        groups.insert(HYSTERESIS);
    }
    if !scenario.disturbances().is_empty() {
        groups.insert(DISTURBANCE);
    }
    let law = &scenario.controller;
    if law.sliding_mode.is_some() || law.sliding_mode_paper.is_some() {
        groups.insert(SLIDING_VARIABLE);
    }
    groups
}

/// Returns the style of a line.
pub(super) fn line(label: &str, colour: [u8; 3]) -> SeriesLines {
    held().with_names([label]).with_colors([colour])
}

/// Returns the style of a signal that holds between its rows.
pub(super) fn held() -> SeriesLines {
    SeriesLines::new().with_interpolation_mode(InterpolationMode::StepAfter)
}

#[cfg(test)]
mod tests {

    use super::*;
    use dbc::{Port, Ports};
    use plan::catalogue::Catalogue;
    use scenario::plant::PlantModel;

    #[test]
    fn what_no_shipped_plant_has_gets_a_view_of_its_own() {
        let find_ports = |_: &PlantModel| {
            let output = |name: &str| Port::output(name, [0.0, 1.0]);
            let outputs = vec![
                output("position_metres"),
                output("winding_temperature_celsius").with_comment("Winding."),
                output("height_metres").with_comment("Height of the load."),
                output("flexor_tension_newtons"),
            ];
            let inputs = vec![
                Port::input("current_amperes", [-40.0, 40.0]),
                Port::input("convection_factor", [0.0, 32.0]),
                Port::input("added_load_kilograms", [-3.3, 3.3]),
            ];
            Some(Ports { inputs, outputs })
        };
        let catalogue = Catalogue {
            find_ports: Some(find_ports),
            ..Catalogue::shipped()
        };
        let text = "schema = 1\nrig = \"dc_motor\"\nname = \"t\"\nduration_seconds = 1.0\n\
            [bus]\nsync_period_milliseconds = 2.0\n[controller.open_loop]\n";
        let plan = testing::plan_beside(text, &[], &catalogue);
        let views = custom_views(&plan, plan.only_loop().unwrap());
        let titles = Vec::from_iter(views.iter().map(|view| view.title.as_str()));
        assert_eq!(
            titles,
            ["Height of the load (m)", "flexor_tension_newtons (N)"]
        );
        let quantities = Quantities::default();
        let group = |name| style(name, &quantities, &[], &views).group;
        assert_eq!(group("height_metres"), "height_metres");
        assert_eq!(group("position_millimetres"), "position");
        assert_eq!(group("winding_temperature_celsius"), "temperature");
        assert!(
            !expected(&plan, plan.only_loop().unwrap()).contains("error"),
            "it has no set-point"
        );
    }
}
