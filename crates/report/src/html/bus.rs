//! The section on the bus: its load, its times, and the counts of the nodes.

use dbc::SignalMissing;
use maud::{Markup, html};

use crate::bus_timing::{BusTiming, histogram};
use crate::plot::{Colour, Extent, Plot, Shape};
use crate::run::Run;
use judge::timing::Timing;

/// Returns the section. All loops share the bus; answers and commands are listed by loop.
pub(super) fn section(run: &Run<'_>) -> Result<Markup, SignalMissing> {
    let timing = BusTiming::new(run.frames, run.plan)?;
    let mut load = Plot::over_time("Bus load", "%");
    load.extent = Extent::FromZero;
    let (times, percent) = (&timing.load_seconds, &timing.load_percent);
    load.draw("load", Colour::Measured, Shape::Line, times, percent);
    let mut sets = vec![("SYNC to SYNC".to_owned(), &timing.cycles)];
    for (one, [answers, commands]) in run.plan.loops.iter().zip(&timing.loops) {
        let [answer, command] = match one.loop_name() {
            None => ["the drive's answer", "the command that follows"].map(str::to_owned),
            Some(name) => [
                format!("the answer of {name}"),
                format!("the command to {name} that follows"),
            ],
        };
        sets.push((format!("SYNC to {answer}"), answers));
        sets.push((format!("SYNC to {command}"), commands));
    }
    let bars = |title: &str, durations| {
        let mut plot = Plot::over_time(title, "cycles");
        plot.x_label = "time (µs)";
        plot.extent = Extent::Logarithmic;
        let (edges, heights) = histogram(durations);
        plot.draw("cycles", Colour::Measured, Shape::Area, edges, heights);
        plot.render()
    };
    Ok(html! {
        h2 #bus { "Bus and timing" }
        p.soft { "Scenario time 0 to " (run.plan.shared.run.duration_seconds) " s, by the stamps of the recorder." }
        div.wide { table.small {
            thead { tr { th { "in µs" } @for head in ["min", "median", "p99", "max"] { th.number { (head) } } } }
            tbody { @for (name, durations) in &sets { @if let Some(spread) = durations.spread() { tr {
                td { (name) }
                @for value in spread { td.number { (value) } }
            } } } }
        } }
        @if let Some(timing) = &run.verdict.timing { (host(timing)) }
        div.plots.even {
            (load.render())
            @for (name, durations) in &sets { (bars(name, durations)) }
        }
    })
}

/// Returns the counts of the nodes' loops, which the recording does not show.
fn host(timing: &Timing) -> Markup {
    html! {
        h3 { "As the nodes saw it" }
        div.wide { table.small {
            thead { tr { th { "in µs" } @for head in ["median", "p99", "p99.9", "max"] { th.number { (head) } } } }
            tbody { @for (name, quantiles) in timing.rows() { tr {
                td { (name) }
                @for value in quantiles.values() { td.number { (format!("{value:.0}")) } }
            } } }
        } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terminal::made_up_timing;

    #[test]
    fn each_quantile_stands_under_its_name() {
        let page = host(&made_up_timing()).into_string();
        let row = |tag: &str, first: &str, rest: [&str; 4]| {
            let rest = rest.map(|cell| format!("<{tag} class=\"number\">{cell}</{tag}>"));
            format!("<tr><{tag}>{first}</{tag}>{}</tr>", rest.concat())
        };
        let header = row("th", "in µs", ["median", "p99", "p99.9", "max"]);
        assert!(page.contains(&header), "{page}");
        let values = row("td", "round trip", ["11", "22", "33", "44"]);
        assert!(page.contains(&values), "{page}");
    }
}
