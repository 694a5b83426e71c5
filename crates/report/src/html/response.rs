//! The section on a run with chirps: gain, phase and offset over frequency.

use judge::{CUT_OFF_GAIN, FrequencyPoint, FrequencyResponse, frequency_responses};
use maud::{Markup, html};

use crate::plot::{Colour, Plot, Shape};
use crate::run::RunLoop;
use crate::terminal::with_minus;
use crate::unit::shown_unit;

/// Curve over frequency: its title, its unit, and its value at a point.
type Curve<'a> = (&'a str, &'a str, fn(&FrequencyPoint) -> f64);

pub(super) fn section(run: &RunLoop<'_>) -> Markup {
    let symbol = shown_unit(run.timeline.quantities.feedback.unit.symbol());
    let responses = frequency_responses(run.plan.database(), run.timeline, run.control_loop);
    let points = || responses.iter().flatten();
    let curves: [Curve<'_>; 3] = [
        ("Gain", "", |point| point.gain),
        ("Phase", "°", |point| point.phase_degrees),
        ("Mean offset from the set-point", symbol, |point| {
            point.offset
        }),
    ];
    html! {
        @if points().next().is_some() {
            (super::heading(run, "Frequency response"))
            p.soft { "Position against set-point, by the turns of the chirp. Bandwidth is where the gain first falls below " (CUT_OFF_GAIN) "." }
            div.plots.even { @for curve in curves { (drawn(curve, &responses)) } }
            details { summary { "as numbers" } div.wide { table {
                thead { tr { th.number { "Hz" } th.number { "gain" } th.number { "phase (°)" } th.number { "offset (" (symbol) ")" } } }
                tbody { @for point in points() { tr {
                    td.number { (format!("{:.3}", point.hertz)) }
                    td.number { (format!("{:.3}", point.gain)) }
                    td.number { (with_minus(format!("{:.1}", point.phase_degrees))) }
                    td.number { (with_minus(format!("{:.3}", point.offset))) }
                } } }
            } } }
        }
    }
}

fn drawn((title, unit, value): Curve<'_>, responses: &[FrequencyResponse]) -> Markup {
    let mut plot = Plot::over_time(title, unit);
    plot.x_label = "frequency (Hz)";
    for (number, points) in responses.iter().enumerate() {
        let hertz = Vec::from_iter(points.iter().map(|point| point.hertz));
        let values = Vec::from_iter(points.iter().map(value));
        let label = format!("chirp {}", number + 1);
        plot.draw(label, Colour::Run(number), Shape::Line, hertz, values);
    }
    plot.render()
}
