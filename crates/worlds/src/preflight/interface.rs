//! Checks of the interface to the bus: its state, its bit rate, and its errors.

use std::io;

use platform::link::{CanState, Link};

use super::checklist::Check;
use super::checklist::Found::{self, Failed, Open, Passed};
use crate::bus_choice::RunBus;

const BITS_PER_KILOBIT: u32 = 1000;

/// Checks the kernel's report on the interface against the bit rate of the rig file or the scenario.
pub(super) fn checks(bus: &RunBus, kilobits_per_second: u32) -> Vec<Check> {
    match bus {
        RunBus::Interface(name) => {
            link_checks(name, platform::link::link(name), kilobits_per_second)
        }
        RunBus::Embedded { .. } | RunBus::Private => vec![
            Check("interface", Passed("canrig's own bus".to_owned())),
            Check("bit rate", Open("this bus has none".to_owned())),
            Check("bus errors", Open("this bus reports none".to_owned())),
        ],
    }
}

fn link_checks(name: &str, link: io::Result<Link>, kilobits_per_second: u32) -> Vec<Check> {
    match link {
        Ok(link) => vec![
            Check("interface", interface(name, &link)),
            Check("bit rate", bit_rate(name, &link, kilobits_per_second)),
            Check("bus errors", bus_errors(name, &link)),
        ],
        Err(error) => {
            let text = format!(
                "the kernel reports nothing of {name}: {error}; look at `ip -details link show {name}`"
            );
            vec![Check("interface", Failed(text))]
        }
    }
}

fn interface(name: &str, link: &Link) -> Found {
    if !link.is_up {
        let text = format!("{name} is down; bring it up with: ip link set {name} up");
        return Failed(text);
    }
    for (is_on, mode) in [
        (link.is_listen_only, "listen-only"),
        (link.is_loopback, "loopback"),
    ] {
        if is_on {
            let text = format!(
                "{name} is in {mode} mode; set it down, then: ip link set {name} type can {mode} off"
            );
            return Failed(text);
        }
    }
    Passed(format!("{name} is up"))
}

fn bit_rate(name: &str, link: &Link, kilobits_per_second: u32) -> Found {
    let Some(bit_rate) = link.bit_rate else {
        return Open("not reported by this interface".to_owned());
    };
    let wanted = kilobits_per_second * BITS_PER_KILOBIT;
    let shown = f64::from(bit_rate) / f64::from(BITS_PER_KILOBIT);
    if bit_rate == wanted {
        return Passed(format!("{shown} kbit/s"));
    }
    let text = format!(
        "{shown} kbit/s instead of {kilobits_per_second}; set {name} down, then: ip link set {name} up type can bitrate {wanted}"
    );
    Failed(text)
}

fn bus_errors(name: &str, link: &Link) -> Found {
    let Some(state) = link.state else {
        return Open("not reported by this interface".to_owned());
    };
    let counters = link.errors.map_or_else(String::new, |[transmit, receive]| {
        format!(", error counters {transmit} (transmit) and {receive} (receive)")
    });
    let look = "look at the cable, both terminating resistors and every node's bit rate";
    let restart = format!("repair the bus, then: ip link set {name} type can restart");
    let (state, advice) = match state {
        CanState::ErrorActive => {
            return Passed(format!("error active{counters}"));
        }
        CanState::ErrorWarning => ("error warning", look),
        CanState::ErrorPassive => ("error passive", look),
        CanState::BusOff => ("bus-off", restart.as_str()),
        CanState::Stopped => ("stopped", restart.as_str()),
    };
    Failed(format!("{state}{counters}; {advice}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: Link = Link {
        is_virtual: false,
        is_can: true,
        is_up: true,
        bit_rate: Some(1_000_000),
        state: Some(CanState::ErrorActive),
        errors: Some([0, 0]),
        is_listen_only: false,
        is_loopback: false,
    };

    fn lines(link: Link) -> String {
        let checks = link_checks("can0", Ok(link), 1000);
        let lines: Vec<String> = checks.iter().map(ToString::to_string).collect();
        lines.join("\n")
    }

    #[test]
    fn a_good_interface_passes_and_a_virtual_one_reports_nothing() {
        let good = "✓ interface     can0 is up\n✓ bit rate      1000 kbit/s\n\
            ✓ bus errors    error active, error counters 0 (transmit) and 0 (receive)";
        assert_eq!(lines(GOOD), good);
        let vcan = Link {
            is_up: true,
            ..Link::default()
        };
        let expected = "✓ interface     can0 is up\n· bit rate      not reported by this interface\n\
            · bus errors    not reported by this interface";
        assert_eq!(lines(vcan), expected);
    }

    #[test]
    fn each_thing_that_is_wrong_is_reported_with_what_to_do() {
        let state = |state, errors| Link {
            state: Some(state),
            errors: Some(errors),
            ..GOOD
        };
        let bit_rate = Link {
            bit_rate: Some(500_000),
            ..GOOD
        };
        let listen_only = Link {
            is_listen_only: true,
            ..GOOD
        };
        let loopback = Link {
            is_loopback: true,
            ..GOOD
        };
        for (link, line) in [
            (Link::default(), "✗ interface     can0 is down; bring it up"),
            (listen_only, "✗ interface     can0 is in listen-only mode"),
            (loopback, "✗ interface     can0 is in loopback mode"),
            (bit_rate, "✗ bit rate      500 kbit/s instead of 1000; "),
            (
                state(CanState::ErrorWarning, [96, 0]),
                "✗ bus errors    error warning, error counters 96",
            ),
            (
                state(CanState::ErrorPassive, [128, 3]),
                "✗ bus errors    error passive, error counters 128 (transmit) and 3",
            ),
            (
                state(CanState::BusOff, [255, 0]),
                "ip link set can0 type can restart",
            ),
        ] {
            let lines = lines(link);
            assert!(lines.contains(line), "{line} is not in\n{lines}");
        }
        let none = link_checks("can0", Err(io::Error::other("no such device")), 1000);
        assert!(
            none[0]
                .to_string()
                .starts_with("✗ interface     the kernel reports nothing of can0")
        );
    }
}
