//! Ports: the named quantities of a plant to which drives and io nodes are wired, and their units.

use std::fmt;

use canopen::object_dictionary::Preset;

use crate::custom::is_name;

/// Largest number of steps that 16 bits hold.
const STEPS_MAX: f64 = 32_767.0;

/// Form of a law's term on the bus.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Width {
    /// Real number of 32 bits.
    Real32,
    /// Two's complement of 8, 16 or 32 bits, in the port's steps.
    Signed(u8),
    /// Unsigned number of up to 8, 16 or 32 bits, in the port's steps. Those below 8 bits share a byte.
    Unsigned(u8),
}

/// Largest real number of 32 bits.
const REAL_MAX: f64 = 3.402_823_5e38;
/// Name of the signal of a sensor without a name.
const POSITION: &str = "position";
/// Names of values that are computed for each loop.
const COMPUTED: [&str; 2] = ["set_point", "error"];
/// Steps of a position on the bus, which has 32 bits, for one of its unit.
const POSITION_STEPS: f64 = 1e3;
const POSITION_RANGE: [f64; 2] = [-2_147_483.648, 2_147_483.647];

/// Named quantity of a plant or a law, in the unit in which the plant or law computes.
#[derive(Clone, Debug, PartialEq)]
pub struct Port {
    /// Name, which ends in the unit: `"flexor_current_amperes"`.
    pub name: String,
    /// Unit in words, as in the name; empty for a number without a unit.
    pub unit: String,
    /// Unit as the DBC writes it.
    pub symbol: String,
    /// Description of the quantity.
    pub comment: String,
    /// Lowest and highest value.
    pub range: [f64; 2],
    /// Value that acts while no node drives the port.
    pub at_rest: f64,
    /// Steps of one unit if the port is published as an integer: 100 for a resolution of 0.01.
    pub steps_per_unit: f64,
    /// Form of a law's term on the bus.
    pub width: Width,
    /// Whether a drive whose `record` is left out publishes the output.
    pub is_published: bool,
    /// Whether it is a term that the law writes in the unit of its loop's position, whatever the name says.
    pub is_position: bool,
}

impl Port {
    /// Makes an input with this range, which is 0 while no node drives it. Its unit is the end of its name.
    pub fn input(name: &str, range: [f64; 2]) -> Self {
        Self::output(name, range)
    }

    /// Makes an output with this range. Its unit is the end of its name.
    pub fn output(name: &str, range: [f64; 2]) -> Self {
        let unit = unit_in(name);
        Self {
            name: name.to_owned(),
            unit: unit.to_owned(),
            symbol: symbol_of(unit).to_owned(),
            comment: String::new(),
            range,
            at_rest: 0.0,
            steps_per_unit: steps_for(range),
            width: Width::Real32,
            is_published: true,
            is_position: false,
        }
    }

    /// Makes a term of a law: an output that is recorded, in 32 bits. Its unit is the end of its name.
    pub fn term(name: &str) -> Self {
        Self::output(name, [-REAL_MAX, REAL_MAX])
    }

    /// Makes a term of a law that is 0 or 1, in one bit.
    pub fn flag(name: &str) -> Self {
        Self::output(name, [0.0, 1.0]).counted(Width::Unsigned(1), 1.0)
    }

    /// Makes a term of a law that is a position of its loop, or a derivative of one. The law writes it in the unit in which it
    /// reads the position. The name is a pattern with the loop's unit, as `reference_{signal}_{unit}` or
    /// `reference_velocity_{unit}_per_second`.
    pub fn position_term(name: &str) -> Self {
        let mut port = Self::output(name, POSITION_RANGE);
        port.is_position = true;
        port.counted(Width::Signed(32), POSITION_STEPS)
    }

    /// Sets the form in which the port is published, and the steps of one unit.
    #[must_use]
    pub fn counted(mut self, width: Width, steps_per_unit: f64) -> Self {
        (self.width, self.steps_per_unit) = (width, steps_per_unit);
        self
    }

    /// Sets the description, a sentence.
    #[must_use]
    pub fn with_comment(self, comment: &str) -> Self {
        let comment = comment.to_owned();
        Self { comment, ..self }
    }

    /// Restricts the publication to drives whose `record` names the port.
    #[must_use]
    pub fn if_recorded(mut self) -> Self {
        self.is_published = false;
        self
    }

    /// Sets another unit than the end of its name, in words and as the DBC writes it.
    #[must_use]
    pub fn with_unit(mut self, unit: &str, symbol: &str) -> Self {
        (self.unit, self.symbol) = (unit.to_owned(), symbol.to_owned());
        self
    }

    /// Sets the value that acts while no node drives the port.
    #[must_use]
    pub fn resting_at(self, at_rest: f64) -> Self {
        Self { at_rest, ..self }
    }

    /// Sets the steps of one unit in which the port is published.
    #[must_use]
    pub fn in_steps(mut self, steps_per_unit: f64) -> Self {
        self.steps_per_unit = steps_per_unit;
        self
    }

    /// Returns its name without that of its plant.
    pub fn local_name(&self) -> &str {
        local_name(&self.name)
    }

    /// Returns the reason why it cannot be a port of a plant, as the end of a sentence.
    fn flaw(&self) -> Option<&'static str> {
        let [min, max] = self.range;
        // Rounded as on the bus: -32.768 in steps of 0.001 are -32768.
        let [lowest, highest] = self.range.map(|end| libm::round(end * self.steps_per_unit));
        let highest_max = if min < 0.0 {
            f64::from(i16::MAX)
        } else {
            f64::from(u16::MAX)
        };
        let fits = lowest >= f64::from(i16::MIN) && highest <= highest_max;
        if !is_name(&self.name) {
            Some("needs a name of at most 64 small letters, digits and underscores")
        } else if min.is_nan() || max.is_nan() || min >= max {
            Some("has a range that ends where it has not begun")
        } else if !(self.steps_per_unit > 0.0 && self.steps_per_unit.is_finite()) {
            Some("needs a number of steps per unit above 0")
        } else if self.has_range() && !fits {
            Some("does not fit 16 bits over its range: take fewer steps per unit")
        } else {
            None
        }
    }

    /// Checks whether its range is valid: two finite numbers, the lower one first.
    pub fn has_range(&self) -> bool {
        let [min, max] = self.range;
        min.is_finite() && max.is_finite() && min < max
    }
}

/// Ports of a plant or a law with certain parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ports {
    /// Inputs of the plant or the law, in its order.
    pub inputs: Vec<Port>,
    /// Outputs of the plant or the law, in its order.
    pub outputs: Vec<Port>,
}

impl Ports {
    /// Joins the ports of plants that are emulated together, each as `PLANT.PORT`, in the order of these plants.
    pub fn joined<'a>(plants: impl IntoIterator<Item = (&'a str, Self)>) -> Self {
        let mut all = Self::default();
        for (plant, mut ports) in plants {
            for port in ports.inputs.iter_mut().chain(&mut ports.outputs) {
                port.name = format!("{plant}.{}", port.name);
            }
            all.inputs.append(&mut ports.inputs);
            all.outputs.append(&mut ports.outputs);
        }
        all
    }

    /// Returns the index of an input.
    pub fn input(&self, name: &str) -> Option<usize> {
        self.inputs.iter().position(|port| port.name == name)
    }

    /// Returns the first port that a plant cannot have, with the reason as the end of a sentence.
    pub fn flaw(&self) -> Option<(&Port, &'static str)> {
        let all = Vec::from_iter(self.inputs.iter().chain(&self.outputs));
        all.iter().enumerate().find_map(|(place, port)| {
            let is_second = all[..place].iter().any(|other| other.name == port.name);
            let reason = port.flaw().or(is_second.then_some("is there twice"))?;
            Some((*port, reason))
        })
    }

    /// Returns the index of an output.
    pub fn output(&self, name: &str) -> Option<usize> {
        self.outputs.iter().position(|port| port.name == name)
    }
}

/// Returns the plant of a port with a name `PLANT.PORT`.
pub fn plant_of_port(port: &str) -> Option<&str> {
    port.split_once('.').map(|(plant, _)| plant)
}

/// Returns the name of a port without that of its plant.
pub fn local_name(port: &str) -> &str {
    port.split_once('.').map_or(port, |(_, name)| name)
}

/// Returns the finest resolution of 1, 2 and 5 times a power of ten whose steps over a range fit 16 bits; 1 for an invalid range.
pub(crate) fn steps_for([min, max]: [f64; 2]) -> f64 {
    let most = STEPS_MAX / min.abs().max(max.abs());
    // The range is neither empty nor without an end.
    if !(most.is_finite() && most > 0.0) {
        return 1.0;
    }
    let mut power = 1.0;
    while power > most {
        power /= 10.0;
    }
    while power * 10.0 <= most {
        power *= 10.0;
    }
    let fitting = [5.0, 2.0].into_iter().find(|step| step * power <= most);
    fitting.unwrap_or(1.0) * power
}

/// Known unit: its word, its symbol, its quantity, and its size in the first unit of that.
type Known = (&'static str, &'static str, &'static str, f64);

/// Quantity of a number without a unit: 100 percent are 1.
const SHARE: &str = "share";

/// Degrees of a radian.
const RADIAN: f64 = 180.0 / std::f64::consts::PI;

/// Units in which names end.
const KNOWN: [Known; 31] = [
    ("metres", "m", "length", 1.0),
    ("millimetres", "mm", "length", 1e-3),
    ("micrometres", "um", "length", 1e-6),
    ("degrees", "deg", "angle", 1.0),
    ("revolutions", "rev", "angle", 360.0),
    ("radians", "rad", "angle", RADIAN),
    ("kilograms", "kg", "mass", 1.0),
    ("grams", "g", "mass", 1e-3),
    ("amperes", "A", "current", 1.0),
    ("milliamperes", "mA", "current", 1e-3),
    ("volts", "V", "voltage", 1.0),
    ("ohms", "Ohm", "resistance", 1.0),
    ("watts", "W", "power", 1.0),
    ("joules", "J", "energy", 1.0),
    ("newtons", "N", "force", 1.0),
    ("newton_metres", "Nm", "torque", 1.0),
    ("pascals", "Pa", "pressure", 1.0),
    ("bar", "bar", "pressure", 1e5),
    ("celsius", "degC", "temperature", 1.0),
    ("kelvins", "K", "temperature difference", 1.0),
    ("seconds", "s", "time", 1.0),
    ("hertz", "Hz", "frequency", 1.0),
    ("percent", "%", SHARE, 1e-2),
    ("litres", "l", "volume", 1.0),
    ("metres_per_second", "m/s", "speed", 1.0),
    ("millimetres_per_second", "mm/s", "speed", 1e-3),
    ("degrees_per_second", "deg/s", "turning speed", 1.0),
    ("revolutions_per_minute", "rpm", "turning speed", 6.0),
    ("revolutions_per_second", "rev/s", "turning speed", 360.0),
    ("radians_per_second", "rad/s", "turning speed", RADIAN),
    ("litres_per_minute", "l/min", "flow", 1.0),
];

/// Returns the words of all units in which names end.
pub fn known_units() -> impl Iterator<Item = &'static str> {
    KNOWN.iter().map(|(word, ..)| *word)
}

fn find(word: &str) -> Option<&'static Known> {
    KNOWN.iter().find(|(known, ..)| *known == word)
}

/// Returns the unit at the end of a name; empty if there is none.
pub fn unit_in(name: &str) -> &str {
    let is_end = |word: &&str| {
        let before = name.strip_suffix(word);
        before.is_some_and(|before| before.is_empty() || before.ends_with('_'))
    };
    let longest = known_units().filter(is_end).max_by_key(|word| word.len());
    longest.map_or("", |word| &name[name.len() - word.len()..])
}

/// Returns the singular of a unit, in words.
pub fn singular(word: &str) -> String {
    let (of, per) = word.split_at(word.find("_per_").unwrap_or(word.len()));
    let one = match of {
        "celsius" | "hertz" => of,
        _ => of.strip_suffix('s').unwrap_or(of),
    };
    format!("{one}{per}")
}

/// Returns a unit as the DBC writes it; the word itself if it has no other form.
pub fn symbol_of(word: &str) -> &str {
    find(word).map_or(word, |(_, symbol, ..)| symbol)
}

/// Returns the factor from the unit `from` to the unit `to`; `None` if they are of different quantities. A number without a unit
/// is a share, or has a unit that only its user knows.
pub fn conversion(from: &str, to: &str) -> Option<f64> {
    if from == to {
        return Some(1.0);
    }
    let kind = |word: &str| match word {
        "" => Some((SHARE, 1.0)),
        word => find(word).map(|(_, _, of, size)| (*of, *size)),
    };
    match (kind(from), kind(to)) {
        (Some((from, size)), Some((to, other))) => (from == to).then_some(size / other),
        _ => (from.is_empty() || to.is_empty()).then_some(1.0),
    }
}

/// Places in the names of keys, metrics and signals, which each loop fills with its quantities: see [`Measurand::name`].
pub const UNIT: &str = "{unit}";
const COMMAND_UNIT: &str = "{command_unit}";
const GAIN: &str = "{gain}";
const GAIN_SECONDS: &str = "{gain_seconds}";

/// Unit in which a loop counts its position: in its set-points, its limits, and its recorded signals.
#[derive(Clone, Debug, Default, Eq, PartialEq)]
pub enum Unit {
    /// Millimetres.
    #[default]
    Millimetres,
    /// Degrees.
    Degrees,
    /// Revolutions.
    Revolutions,
    /// Any other unit, by its word.
    Other(String),
}

impl Unit {
    /// Units of lengths and angles, which a sensor can have whatever the unit of its port.
    pub(crate) const NAMED: [Self; 3] = [Self::Millimetres, Self::Degrees, Self::Revolutions];

    /// Returns the unit of a word.
    pub fn from_word(word: &str) -> Self {
        let named = Self::NAMED.into_iter().find(|unit| unit.word() == word);
        named.unwrap_or_else(|| Self::Other(word.to_owned()))
    }

    /// Returns the word of the unit.
    pub fn word(&self) -> &str {
        match self {
            Self::Millimetres => "millimetres",
            Self::Degrees => "degrees",
            Self::Revolutions => "revolutions",
            Self::Other(word) => word,
        }
    }

    /// Returns the word of the unit in which a law of one loop reads: metres in a loop in millimetres.
    pub fn law_word(&self) -> &str {
        match self {
            Self::Millimetres => "metres",
            unit => unit.word(),
        }
    }

    /// Returns the unit as plots and the DBC write it.
    pub fn symbol(&self) -> &str {
        symbol_of(self.word())
    }

    /// Returns the symbol as [`Unit::symbol`] if the unit is known, else an empty text.
    pub fn known_symbol(&self) -> &'static str {
        find(self.word()).map_or("", |(_, symbol, ..)| symbol)
    }

    /// Returns the units in which a port of this unit can be measured, the best known first.
    pub fn fitting_port(port_unit: &str) -> Vec<Self> {
        let fits = |unit: &Self| conversion(port_unit, unit.word()).is_some();
        let mut fitting = Vec::from_iter(Self::NAMED.into_iter().filter(fits));
        if fitting.is_empty() {
            let word = Some(port_unit).filter(|word| !word.is_empty());
            fitting.push(Self::Other(word.unwrap_or("percent").to_owned()));
        }
        fitting
    }

    /// Returns the counts of the drive's position object (0x6064) for one unit: micrometres, thousandths of a degree, millionths
    /// of a revolution.
    pub fn counts(&self) -> f64 {
        match self {
            Self::Revolutions => 1e6,
            _ => 1e3,
        }
    }

    /// Returns the SI unit of the drive's positions (0x60A8, CiA 303-2): prefix and unit; 0 for a unit without a code.
    pub fn si_position(&self) -> u32 {
        let (prefix, unit): (u32, u32) = match self {
            Self::Millimetres => (0xFA, 0x01),
            Self::Degrees => (0xFD, 0x41),
            Self::Revolutions => (0xFA, 0xB4),
            Self::Other(word) if word == "celsius" => (0xFD, 0x2D),
            Self::Other(_) => return 0,
        };
        prefix << 24 | unit << 16
    }

    /// Returns the same for the drive's data sheet, together with the unit of velocities (0x60A9).
    pub(crate) fn presets(&self) -> [Preset; 2] {
        let position = self.si_position();
        let velocity = match position {
            0 => 0,
            code => code | BY_SECOND,
        };
        [
            Preset::new(SI_UNIT_POSITION, 0, position.into()),
            Preset::new(SI_UNIT_VELOCITY, 0, velocity.into()),
        ]
    }
}

/// Objects of a drive (CiA 402-2).
const SI_UNIT_POSITION: u16 = 0x60A8;
const SI_UNIT_VELOCITY: u16 = 0x60A9;
/// "Per second" in the code of an SI unit (CiA 303-2).
const BY_SECOND: u32 = 0x0300;

/// Output quantity of an amplifier: a signal in a unit.
#[derive(Clone, Copy, Debug, Default, Eq, PartialEq)]
pub enum Command {
    /// A current, in amperes.
    #[default]
    Current,
    /// A voltage, in volts.
    Voltage,
    /// A force, in newtons.
    Force,
    /// A torque, in newton metres.
    Torque,
}

impl Command {
    pub(crate) const ALL: [Self; 4] = [Self::Current, Self::Voltage, Self::Torque, Self::Force];

    /// Returns the name of the signal: the quantity of its unit.
    pub fn signal(self) -> &'static str {
        find(self.word()).map_or("", |(_, _, quantity, _)| quantity)
    }

    /// Returns the word of its unit.
    pub fn word(self) -> &'static str {
        match self {
            Self::Current => "amperes",
            Self::Voltage => "volts",
            Self::Force => "newtons",
            Self::Torque => "newton_metres",
        }
    }

    /// Returns its unit as the DBC writes it.
    pub fn symbol(self) -> &'static str {
        find(self.word()).map_or("", |(_, symbol, ..)| symbol)
    }

    /// Returns the signal as the title of a plot.
    pub fn title(self) -> String {
        title(self.signal())
    }

    /// Returns the output quantity of an amplifier that drives a port in this unit; `None` if no amplifier can.
    pub fn in_port_unit(unit: &str) -> Option<Self> {
        let mut all = Self::ALL.into_iter();
        all.find(|command| conversion(command.word(), unit).is_some())
    }
}

/// Signal that a loop measures and controls, with its unit, and the quantity that it commands.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct Measurand {
    /// Name of the signal.
    pub signal: String,
    /// Unit of the signal.
    pub unit: Unit,
    /// Output quantity of the amplifier of the loop's drive.
    pub command: Command,
}

impl Default for Measurand {
    fn default() -> Self {
        Self::position(Unit::default())
    }
}

impl Measurand {
    /// Makes a position in a unit.
    pub fn position(unit: Unit) -> Self {
        Self {
            signal: POSITION.to_owned(),
            unit,
            command: Command::default(),
        }
    }

    /// Sets another command of the loop.
    #[must_use]
    pub fn commanding(self, command: Command) -> Self {
        Self { command, ..self }
    }

    /// Fills the places of a pattern, or of a text with patterns: `{signal}_{unit}` becomes `speed_revolutions_per_minute`, and
    /// `{command}_{command_unit}` becomes `voltage_volts`. In names of gains, `{gain}` is one unit of the command by one of the
    /// position as laws read it, as `amperes_per_metre`, and `{gain_seconds}` the same times a second.
    pub fn name(&self, pattern: &str) -> String {
        if !is_pattern(pattern) {
            return pattern.to_owned();
        }
        let (command, by) = (self.command.word(), singular(self.unit.law_word()));
        let places = [
            ("{signal}", self.signal.clone()),
            (UNIT, self.unit.word().to_owned()),
            ("{command}", self.command.signal().to_owned()),
            (COMMAND_UNIT, command.to_owned()),
            (GAIN, format!("{command}_per_{by}")),
            (
                GAIN_SECONDS,
                format!("{}_seconds_per_{by}", singular(command)),
            ),
        ];
        let mut name = pattern.to_owned();
        for (place, word) in &places {
            if name.contains(place) {
                name = name.replace(place, word);
            }
        }
        name
    }

    /// Checks whether its name is also that of a value that is computed.
    pub(crate) fn is_ambiguous(&self) -> bool {
        COMPUTED.contains(&&*self.signal)
    }

    /// Returns name and symbol of a term of a law in this loop.
    pub fn term(&self, name: &str, port: &Port) -> (String, String) {
        let symbol = match name.split_once(UNIT) {
            Some((_, "_per_second")) => format!("{}/s", self.unit.symbol()),
            Some(_) => self.unit.symbol().to_owned(),
            None => port.symbol.clone(),
        };
        (self.name(name), symbol)
    }

    /// Returns the signal in words, as the title of a plot.
    pub fn title(&self) -> String {
        title(&self.signal)
    }
}

/// Checks whether a name has places for the quantities of a loop.
pub fn is_pattern(name: &str) -> bool {
    name.contains('{')
}

/// Checks whether a name is that of a gain, which may be by another unit of the loop's quantity.
pub(crate) fn is_gain(name: &str) -> bool {
    name.contains(GAIN) || name.contains(GAIN_SECONDS)
}

/// Checks whether two names are those of one gain, by two units.
pub(crate) fn is_same_gain(one: &str, other: &str) -> bool {
    // Most names differ before the unit already.
    let [before, too] = [one, other].map(|name| name.split_once("_per_").map(|(before, _)| before));
    let is_by = |gain: &str, command| {
        let words = known_units().map(|unit| {
            let unit = Unit::Other(unit.to_owned());
            Measurand::position(unit).commanding(command).name(gain)
        });
        let words = Vec::from_iter(words);
        let mut parts = words
            .iter()
            .filter_map(|word| one.split_once(word.as_str()));
        parts.any(|(before, after)| {
            let mut names = words.iter().map(|word| format!("{before}{word}{after}"));
            names.any(|name| name == other)
        })
    };
    let mut gains = [GAIN, GAIN_SECONDS].into_iter();
    let mut is_gain = |gain| Command::ALL.into_iter().any(|command| is_by(gain, command));
    before.is_some() && before == too && gains.any(&mut is_gain)
}

impl fmt::Display for Unit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.word())
    }
}

/// Returns the name of a signal in words, as the title of a plot.
fn title(signal: &str) -> String {
    let words = signal.replace('_', " ");
    let mut letters = words.chars();
    let first = letters.next().into_iter().flat_map(char::to_uppercase);
    first.chain(letters).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_gain_has_a_name_by_each_unit() {
        for (other, is_same) in [
            ("integral_amperes_per_metre_second", true),
            ("integral_amperes_per_millimetre_second", true),
            ("integral_amperes_per_revolution_per_minute_second", true),
            ("integral_volts_per_degree_second", false),
            ("integral_amperes_per_degree", false),
            ("proportional_amperes_per_degree_second", false),
            ("integral_amperes", false),
        ] {
            assert_eq!(
                is_same_gain("integral_amperes_per_degree_second", other),
                is_same,
                "{other}"
            );
            assert_eq!(
                is_same_gain(other, "integral_amperes_per_degree_second"),
                is_same,
                "{other}"
            );
        }
        assert!(is_same_gain(
            "derivative_ampere_seconds_per_metre",
            "derivative_ampere_seconds_per_degree"
        ));
    }

    #[test]
    fn a_unit_is_the_end_of_a_name() {
        for (name, unit) in [
            ("current_amperes", "amperes"),
            (
                "motor_speed_revolutions_per_minute",
                "revolutions_per_minute",
            ),
            ("spindle_revolutions", "revolutions"),
            ("brake_newton_metres", "newton_metres"),
            ("martensite_fraction", ""),
            ("metres", "metres"),
            ("parametres", ""),
        ] {
            assert_eq!(unit_in(name), unit, "{name}");
        }
    }

    #[test]
    fn units_of_one_kind_are_converted_and_others_are_not() {
        assert_eq!(conversion("metres", "millimetres"), Some(1000.0));
        assert_eq!(conversion("degrees", "revolutions"), Some(1.0 / 360.0));
        assert_eq!(conversion("degrees", "millimetres"), None);
        assert_eq!(conversion("bogus", "bogus"), Some(1.0));
        assert_eq!(
            Unit::fitting_port("radians"),
            [Unit::Degrees, Unit::Revolutions]
        );
        let celsius = Unit::Other("celsius".to_owned());
        assert_eq!(Unit::fitting_port("celsius"), [celsius]);
        let percent = Unit::Other("percent".to_owned());
        assert_eq!(Unit::fitting_port(""), [percent]);
        assert_eq!(conversion("", "percent"), Some(100.0));
        assert_eq!(conversion("", "fraction"), Some(1.0));
        assert_eq!(conversion("", "celsius"), None);
        assert_eq!(conversion("celsius", "fraction"), None);
    }

    #[test]
    fn names_have_the_quantities_of_their_loop() {
        let shipped = Measurand::default();
        let torque_of_a_joint = Measurand::position(Unit::Degrees).commanding(Command::Torque);
        let force_of_a_torque =
            Measurand::position(Unit::Other("newton_metres".to_owned())).commanding(Command::Force);
        let oven = Measurand {
            signal: "temperature".to_owned(),
            unit: Unit::Other("celsius".to_owned()),
            command: Command::Voltage,
        };
        for (pattern, names) in [
            (
                "{signal}_{unit}_max",
                [
                    "position_millimetres_max",
                    "position_degrees_max",
                    "position_newton_metres_max",
                    "temperature_celsius_max",
                ],
            ),
            (
                "{command}_ripple_{command_unit}_rms",
                [
                    "current_ripple_amperes_rms",
                    "torque_ripple_newton_metres_rms",
                    "force_ripple_newtons_rms",
                    "voltage_ripple_volts_rms",
                ],
            ),
            (
                "integral_{gain}_second",
                [
                    "integral_amperes_per_metre_second",
                    "integral_newton_metres_per_degree_second",
                    "integral_newtons_per_newton_metre_second",
                    "integral_volts_per_celsius_second",
                ],
            ),
            (
                "`derivative_{gain_seconds}` is missing",
                [
                    "`derivative_ampere_seconds_per_metre` is missing",
                    "`derivative_newton_metre_seconds_per_degree` is missing",
                    "`derivative_newton_seconds_per_newton_metre` is missing",
                    "`derivative_volt_seconds_per_celsius` is missing",
                ],
            ),
            ("overshoot_percent", ["overshoot_percent"; 4]),
        ] {
            let loops = [&shipped, &torque_of_a_joint, &force_of_a_torque, &oven];
            assert_eq!(loops.map(|one| one.name(pattern)), names);
        }
        assert_eq!(
            Command::in_port_unit("milliamperes"),
            Some(Command::Current)
        );
        assert_eq!(
            Command::in_port_unit("newton_metres"),
            Some(Command::Torque)
        );
        assert_eq!(Command::in_port_unit("kilograms"), None);
    }

    #[test]
    fn a_term_that_is_a_position_has_the_unit_of_its_loop() {
        let term = |pattern: &str, unit: Unit| {
            Measurand::position(unit).term(pattern, &Port::position_term(pattern))
        };
        let named = |name: &str, symbol: &str| (name.to_owned(), symbol.to_owned());
        let velocity = "reference_velocity_{unit}_per_second";
        assert_eq!(
            term(velocity, Unit::Millimetres),
            named("reference_velocity_millimetres_per_second", "mm/s")
        );
        assert_eq!(
            term("reference_{signal}_{unit}", Unit::Degrees),
            named("reference_position_degrees", "deg")
        );
        let plain = Port::term("sum_amperes");
        assert_eq!(
            Measurand::default().term("sum_amperes", &plain),
            named("sum_amperes", "A")
        );
    }

    #[test]
    fn the_steps_of_a_range_fit_16_bits_and_are_as_fine_as_they_can_be() {
        for (range, steps) in [
            ([-60.0, 60.0], 500.0),
            ([0.0, 1.0], 20_000.0),
            ([-1e6, 1e6], 0.02),
            ([0.0, f64::INFINITY], 1.0),
            ([0.0, 0.0], 1.0),
            ([-1e-310, 1e-310], 1.0),
        ] {
            assert!((steps_for(range) / steps - 1.0).abs() < 1e-9, "{range:?}");
        }
    }

    #[test]
    fn a_port_that_the_bus_cannot_carry_is_refused() {
        let port = |name: &str, steps, min, max| Port::output(name, [min, max]).in_steps(steps);
        assert_eq!(port("angle_degrees", 100.0, -180.0, 180.0).flaw(), None);
        assert_eq!(port("speed", 1e3, -32.768, 32.767).flaw(), None);
        let endless = port("turns", 1.0, f64::NEG_INFINITY, f64::INFINITY);
        assert_eq!(endless.flaw(), None);
        for (wrong, reason) in [
            (port("Angle (°)", 1.0, 0.0, 1.0), "name"),
            (port("angle", 0.0, 0.0, 1.0), "above 0"),
            (port("angle", f64::NAN, 0.0, 1.0), "above 0"),
            (port("angle", 1.0, 1.0, 1.0), "has not begun"),
            (port("angle", 1.0, 1.0, f64::NAN), "has not begun"),
            (port("angle", 1e3, -180.0, 180.0), "16 bits"),
            (port("angle", 1.0, 0.0, 65_536.0), "16 bits"),
        ] {
            assert!(wrong.flaw().unwrap().contains(reason), "{wrong:?}");
        }
    }

    #[test]
    fn the_codes_are_those_of_cia_303_2() {
        assert_eq!(Unit::Millimetres.si_position(), 0xFA01_0000);
        assert_eq!(Unit::Degrees.si_position(), 0xFD41_0000);
        assert_eq!(Unit::Other("litres".to_owned()).si_position(), 0);
    }
}
