//! Common parts of all HTML pages: one self-contained file, light and dark. A page with plots has a script, which is the only one
//! that a browser runs in it.

use base64::prelude::{BASE64_STANDARD, Engine};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use platform::terminal::printable;
use sha2::{Digest, Sha256};

use super::terminal;
use judge::verdict::{Identity, Metric, Outcome};
use recording::frames::Clock;
use recording::run_folder::file;

/// Script and style of plots.
const PLOTS_SCRIPT: &str = include_str!("plots.js");
const PLOTS_STYLE: &str = include_str!("plots.css");

/// Returns a page with this title. As on a terminal, no name in it turns the text around it or hides a part of itself.
pub fn page(title: &str, body: &Markup) -> String {
    // No name can look like this, since angle brackets in names are escaped.
    let has_plots = body.0.contains("<figure class=\"plot");
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                @if has_plots { meta http-equiv="Content-Security-Policy" content=(policy(PLOTS_SCRIPT)); }
                // An icon without bytes keeps browsers from requesting one.
                link rel="icon" href="data:,";
                title { (title) }
                style {
                    (PreEscaped(include_str!("style.css")))
                    @if has_plots { (PreEscaped(PLOTS_STYLE)) }
                }
            }
            body {
                main { (body) }
                @if has_plots { script { (PreEscaped(PLOTS_SCRIPT)) } }
            }
        }
    };
    printable(&page.into_string()).into_owned() + "\n"
}

/// Returns the content policy of a page: no file is loaded, and this script alone runs.
fn policy(script: &str) -> String {
    let hash = BASE64_STANDARD.encode(Sha256::digest(script));
    format!(
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{hash}'; base-uri 'none'; form-action 'none'"
    )
}

/// Returns a name as files have it, which may be broken after each underscore.
pub fn name(name: &str) -> Markup {
    html! { @for part in name.split_inclusive('_') { (part) @if part.ends_with('_') { wbr; } } }
}

/// Returns a key, which may be broken after each point and underscore.
pub fn key(key: &str) -> Markup {
    html! { @for part in key.split_inclusive('.') { (name(part)) wbr; } }
}

/// Returns a value of the command line.
pub fn set(set: &str) -> Markup {
    let (name, value) = set.split_once('=').unwrap_or((set, ""));
    html! { "--set " (key(name)) "=" (value) }
}

/// Returns the outcome as a badge.
pub fn badge(outcome: Outcome) -> Markup {
    html! { span.outcome.(class(outcome)) { (word(outcome)) } }
}

/// Returns the word for an outcome, without the capitals of a terminal.
pub fn word(outcome: Outcome) -> String {
    outcome.word().to_lowercase()
}

/// Returns the kind of time that a clock gives.
pub fn time_by(clock: Clock) -> &'static str {
    match clock {
        Clock::Wall => "real time",
        Clock::Virtual => "virtual time",
    }
}

/// Returns a remark as a sentence. One of a node begins with the name of the node, which stays.
pub fn sentence(remark: &str) -> String {
    let names_node = remark
        .split_once(": ")
        .is_some_and(|(name, _)| !name.contains(' '));
    let mut letters = remark.chars();
    let first = letters.next().map(String::from).unwrap_or_default();
    let first = if names_node {
        first
    } else {
        first.to_uppercase()
    };
    let end = if remark.ends_with(['.', '!', '?']) {
        ""
    } else {
        "."
    };
    first + letters.as_str() + end
}

/// Returns the identity of what was played, as part of a list of facts.
pub fn identity(identity: &Identity) -> Markup {
    const SHA_256_DIGITS: usize = 64;
    // The linker's build ID is shorter.
    let is_hash = identity.program.len() == SHA_256_DIGITS;
    let kind = if is_hash { "SHA-256" } else { "build ID" };
    html! {
        div { dt { "plant" } dd { (identity.plant) } }
        div { dt { "law" } dd { (identity.law) } }
        div.hash { dt { "program, " (kind) } dd { code { (identity.program) } } }
        @for (name, hash) in &identity.files { div.hash { dt { (name) ", SHA-256" } dd { code { (hash) } } } }
    }
}

/// Returns the text in place of date and host, which the page of a play in virtual time lacks: played again, it is the same.
pub fn undated() -> Markup {
    html! { p.soft { "When and where it was played is in " a href=(file::PLAYED) { (file::PLAYED) } ": in virtual time every play leaves the same page." } }
}

/// Returns the class of an outcome in the style sheet.
pub fn class(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Pass => "pass",
        Outcome::Fail => "fail",
        Outcome::Inconclusive | Outcome::Incomplete => "unsure",
    }
}

/// Returns the cell that says whether a limit was met.
pub fn result(metric: &Metric, outcome: Outcome) -> Markup {
    match (metric.passed, outcome) {
        (None, _) if metric.limit.is_some() => html! { span.unsure { "not judged" } },
        (None, _) => html! {},
        (Some(_), Outcome::Inconclusive) => html! { span.unsure { "not judged" } },
        (Some(true), _) => html! { span.pass { "pass" } },
        (Some(false), _) => html! { span.fail { "fail" } },
    }
}

/// Returns the metrics as a table.
pub fn metrics<'a>(metrics: impl Iterator<Item = &'a Metric> + Clone, outcome: Outcome) -> Markup {
    let tests_any = metrics
        .clone()
        .any(|metric| !metric.requirements.is_empty());
    html! {
        div.wide { table.stacked {
            thead { tr {
                th { "metric" } th.number { "measured" } th.number { "limit" } th { "result" }
                @if tests_any { th { "requirements" } }
            } }
            tbody { @for metric in metrics { tr {
                td.name { (name(&metric.name)) }
                td.number data-name="measured" { (terminal::measured(metric)) }
                td.number.none[metric.limit.is_none()] data-name="limit" { (terminal::limit(&metric.name, metric.limit)) }
                td.none[metric.limit.is_none()] data-name="result" { (result(metric, outcome)) }
                @if tests_any { td.none[metric.requirements.is_empty()] data-name="requirements" { (metric.requirements.join(", ")) } }
            } } }
        } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::{Colour, Plot, Shape};

    #[test]
    fn no_name_turns_or_hides_text_around_it() {
        let body = html! { h1 { "a\u{202e}b_\u{1b}[31m\u{200b}<c>" } p { "25 °C → ≤ 3 mm" } };
        let page = page("\u{2066}run", &body);
        assert!(page.contains("a\\u202eb_\\u001b[31m\\u200b&lt;c&gt;"));
        assert!(page.contains("<title>\\u2066run</title>"));
        assert!(page.contains("25 °C → ≤ 3 mm"));
    }

    #[test]
    fn a_page_with_plots_has_one_script_which_its_policy_names_and_any_other_none() {
        let mut plot = Plot::over_time("<script>", "mm");
        let (x, y) = ([0.0, 1.0], [0.0, 1.0]);
        plot.draw("</script>", Colour::Measured, Shape::Line, &x, &y);
        let with_plot = page("run", &plot.render());
        let script = with_plot.split_once("<script>").unwrap().1;
        let script = script.split_once("</script>").unwrap().0;
        assert_eq!(script, PLOTS_SCRIPT);
        assert_eq!(with_plot.matches("<script").count(), 1);
        let hash = BASE64_STANDARD.encode(Sha256::digest(script));
        let policy = format!(
            "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{hash}';"
        );
        // maud does not escape single quotes.
        assert!(with_plot.contains(&policy), "{policy}");
        let without = page("run", &html! { p { "<figure class=\"plot" } });
        assert!(!without.contains("<script") && !without.contains("Content-Security-Policy"));
    }
}
