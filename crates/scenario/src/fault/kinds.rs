//! The table of faults. Schema, loader, checks, torture and book read its columns; the crates that play a fault know it by its
//! name.

/// Kind of fault: `[[fault.GROUP.NAME]]`.
#[derive(Debug, PartialEq)]
pub struct Kind {
    /// Part of a run in which it acts.
    pub group: Group,
    /// Unique name.
    pub name: &'static str,
    /// Time at which it acts.
    pub time: Time,
    /// Actor that plays it.
    pub actor: Actor,
    /// Cyclic frames that it can keep from the bus or delay.
    pub touch: Touch,
    /// Whether the cyclic frames of its node come at other times than at the rate of the bus.
    pub is_rate_changed: bool,
    /// Keys other than those of its time.
    pub keys: &'static [Key],
    /// Description in the schema and in the book.
    pub text: &'static str,
}

/// Part of a run in which a fault acts.
#[derive(Clone, Copy, Debug, Eq, Ord, PartialEq, PartialOrd)]
pub enum Group {
    /// The bus.
    Bus,
    /// A node.
    Node,
    /// The sensor of a drive.
    Sensor,
    /// The amplifier of a drive.
    Amplifier,
    /// A plant, or the part of it that a drive moves.
    Plant,
}

/// Actor that plays a fault.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Actor {
    /// The model of the bus, to the frames of others.
    Bus,
    /// A foreign node that the model of the bus adds.
    Foreign,
    /// The node that canrig plays.
    Node,
    /// The bench, to the process of a node if it has one of its own; else the node.
    Process,
    /// The bench, by a message to the node, whoever plays it.
    Message,
}

/// Time of a fault.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Time {
    /// From `from_seconds` to `until_seconds`, or to the end of the run without the latter.
    Lasts,
    /// As `Lasts`, with a required end.
    Ends,
    /// At `at_seconds`.
    Instant,
    /// At the boot of its node.
    Boot,
}

/// Cyclic frames that a fault can keep from the bus. The node itself reports its reaction to a fault.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Touch {
    /// No frames.
    Nothing,
    /// The frames of all nodes.
    All,
    /// The frames of its node.
    Node,
    /// The frames of its node, and of all that share its CAN controller.
    Receiver,
    /// The frames of its node, or of all nodes, which its `delay_milliseconds` delays.
    Late,
    /// The heartbeats of its node: the nodes that watch it may stop.
    Heartbeats,
}

/// Key of a fault's table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key {
    /// Name, which ends in the unit.
    pub name: &'static str,
    /// Form of its values.
    pub form: Form,
    /// Whether it may be left out.
    pub need: Need,
    /// Values that torture draws.
    pub drawn: Drawn,
    /// Description in the schema and in the book.
    pub text: &'static str,
}

/// Form of a key's values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Form {
    /// A number in a range.
    Number(f64, f64),
    /// A whole number in a range.
    Whole(u32, u32),
    /// One of these words, each with its description.
    Word(&'static [(&'static str, &'static str)]),
    /// The name of the controller, of a drive or of an io node.
    Node,
    /// The name of the controller or of a drive, or canrig's own node.
    Station,
}

/// Whether a key may be left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Need {
    /// It is required.
    Required,
    /// It is optional and has no default.
    Optional,
    /// It has this number by default.
    Default(f64),
    /// It has this word by default.
    DefaultWord(&'static str),
}

/// Values of a key that torture draws, from harmless to severe (chosen, not measured).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drawn {
    /// A number of this range.
    Between(f64, f64),
    /// A whole number of this range.
    Whole(u32, u32),
    /// An identifier of the run's own frames, seven times out of ten.
    Identifier,
    /// An identifier from this one up to those of the plants' reports.
    Foreign(u32),
    /// A node-ID that no other node has.
    FreeNodeId,
    /// A node of the run.
    Node,
    /// A node of the run, or canrig's own node.
    Station,
    /// As `Station`, every second time.
    PerhapsStation,
    /// This word, three times out of ten.
    Word(&'static str),
}

impl Key {
    /// Makes a required number. Torture draws it from its whole range.
    pub(super) const fn number(name: &'static str, min: f64, max: f64) -> Self {
        Self {
            name,
            form: Form::Number(min, max),
            need: Need::Required,
            drawn: Drawn::Between(min, max),
            text: "",
        }
    }

    /// Makes a whole number, as [`Key::number`].
    const fn whole(name: &'static str, min: u32, max: u32) -> Self {
        Self {
            form: Form::Whole(min, max),
            drawn: Drawn::Whole(min, max),
            ..Self::number(name, 0.0, 0.0)
        }
    }

    /// Sets whether it may be left out.
    pub(super) const fn needed(self, need: Need) -> Self {
        Self { need, ..self }
    }

    /// Sets the values that torture draws.
    const fn drawn(self, drawn: Drawn) -> Self {
        Self { drawn, ..self }
    }

    /// Sets the description.
    pub(super) const fn with_text(self, text: &'static str) -> Self {
        Self { text, ..self }
    }

    /// Checks whether its value is the name of a node.
    pub(super) fn names_node(&self) -> bool {
        matches!(self.form, Form::Node | Form::Station)
    }
}

impl Group {
    /// All groups, in the order of the format.
    pub const ALL: [Self; 5] = [
        Self::Bus,
        Self::Node,
        Self::Sensor,
        Self::Amplifier,
        Self::Plant,
    ];

    /// Returns its key in `[fault]`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bus => "bus",
            Self::Node => "node",
            Self::Sensor => "sensor",
            Self::Amplifier => "amplifier",
            Self::Plant => "plant",
        }
    }

    /// Returns its description.
    pub(super) fn text(self) -> &'static str {
        match self {
            Self::Bus => {
                "Faults of the bus, in virtual time on the modelled bus only. A fault of frames hits the frames of one identifier, or all frames if none is given: each with a probability, and after a hit a number of them in a row."
            }
            Self::Node => {
                "Faults of the node of a drive, of an io node or of the controller. The node itself behaves wrongly, and `bus.log` shows the frames that it still sends. In real time a crash or hang of the controller is a SIGKILL or SIGSTOP of its process; the other kinds are the same in all worlds."
            }
            Self::Sensor => {
                "Faults of the position sensor. They act before the drive, so `bus.log` shows the wrong position that the drive sends. Their order: offset, drift, noise and spikes act on the position before its conversion, then lost bits and stuck on the converted number."
            }
            Self::Amplifier => {
                "Faults of the current amplifier. They act after the drive, and `bus.log` shows the current that really flows. If several act at a time, `dead` takes precedence, then `stuck_on`."
            }
            Self::Plant => {
                "Faults of the wire and the mechanics; `bus.log` shows their consequences only."
            }
        }
    }
}

impl Kind {
    /// Returns the kind of this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        KINDS.iter().find(|kind| kind.name == name)
    }

    /// Returns its key that names a node, if it has one.
    pub fn node_key(&self) -> Option<&'static Key> {
        self.keys.iter().find(|key| key.names_node())
    }

    /// Checks whether it happens to a drive. The drive need not be named if there is only one.
    pub fn is_drive_fault(&self) -> bool {
        self.group != Group::Bus && self.node_key().is_none()
    }

    /// Returns the path of its array in the document.
    pub(super) fn path(&self) -> String {
        format!("fault.{}.{}", self.group.name(), self.name)
    }

    /// Returns the heading of its table.
    pub fn heading(&self) -> String {
        format!("[[{}]]", self.path())
    }
}

const NODE: Key = Key {
    name: "node",
    form: Form::Node,
    need: Need::Required,
    drawn: Drawn::Node,
    text: "The node that fails.",
};
const SENDER: Key = Key {
    name: "sender",
    form: Form::Station,
    need: Need::Required,
    drawn: Drawn::Station,
    text: "Station whose frames are affected.",
};
const IDENTIFIER: Key = Key::whole("identifier", 0, 2047)
    .needed(Need::Optional)
    .drawn(Drawn::Identifier)
    .with_text("Only frames with this identifier.");
const PROBABILITY: Key = Key::number("probability", 0.0, 1.0)
    .needed(Need::Default(1.0))
    .drawn(Drawn::Between(0.01, 1.0))
    .with_text("Probability for each frame.");
const BURST: Key = Key::whole("burst_frames", 1, 100_000)
    .needed(Need::Default(1.0))
    .drawn(Drawn::Whole(1, 60))
    .with_text("Number of frames that are affected in a row.");
const FOREIGN: Key = Key::whole("identifier", 1, 2047)
    .drawn(Drawn::Foreign(1))
    .with_text("Identifier of its frames; a lower one wins the arbitration.");

const BUS: Kind = Kind {
    group: Group::Bus,
    name: "",
    time: Time::Lasts,
    actor: Actor::Bus,
    touch: Touch::All,
    is_rate_changed: false,
    keys: &[],
    text: "",
};
const AT_NODE: Kind = Kind {
    group: Group::Node,
    actor: Actor::Node,
    touch: Touch::Node,
    keys: &[NODE],
    ..BUS
};
const SENSOR: Kind = Kind {
    group: Group::Sensor,
    actor: Actor::Node,
    touch: Touch::Nothing,
    ..BUS
};
const AMPLIFIER: Kind = Kind {
    group: Group::Amplifier,
    ..SENSOR
};
const PLANT: Kind = Kind {
    group: Group::Plant,
    ..SENSOR
};

/// All kinds, in the order of the format. Torture draws the keys of a kind in their order here.
pub static KINDS: &[Kind] = &[
    Kind {
        name: "lose",
        // The receiver does not answer a frame that it misses.
        touch: Touch::Receiver,
        keys: &[
            Key {
                name: "receiver",
                text: "Station that misses the frames.",
                ..SENDER
            },
            IDENTIFIER,
            PROBABILITY,
            BURST,
        ],
        text: "One receiver overruns: it misses frames that all others receive. `bus.log` shows these frames.",
        ..BUS
    },
    Kind {
        name: "delay",
        touch: Touch::Late,
        keys: &[
            SENDER,
            Key::number("delay_milliseconds", 0.0, 10_000.0)
                .drawn(Drawn::Between(0.1, 20.0))
                .with_text("Delay of the frames."),
            IDENTIFIER,
            PROBABILITY,
            BURST,
        ],
        text: "The sender's frames are delayed before they take part in the arbitration. `bus.log` shows them when they are sent.",
        ..BUS
    },
    Kind {
        name: "duplicate",
        touch: Touch::Nothing,
        keys: &[SENDER, IDENTIFIER, PROBABILITY, BURST],
        text: "A gateway between the sender and the bus sends frames twice. `bus.log` shows both copies.",
        ..BUS
    },
    Kind {
        name: "reorder",
        keys: &[SENDER, IDENTIFIER, PROBABILITY, BURST],
        text: "A gateway between the sender and the bus swaps a frame with the sender's next one. `bus.log` shows the new order.",
        ..BUS
    },
    Kind {
        name: "corrupt",
        keys: &[
            SENDER,
            Key::whole("inverted_bits", 1, 64)
                .needed(Need::Default(1.0))
                .drawn(Drawn::Whole(1, 8))
                .with_text("Number of inverted bits, at random places."),
            IDENTIFIER,
            PROBABILITY,
            BURST,
        ],
        text: "A gateway between the sender and the bus changes payloads; the CRC on the bus is correct. `bus.log` shows the changed frames.",
        ..BUS
    },
    Kind {
        name: "bit_error",
        keys: &[
            SENDER
                .needed(Need::Optional)
                .drawn(Drawn::PerhapsStation)
                .with_text("Only the transmissions of this station."),
            IDENTIFIER,
            PROBABILITY.with_text("Probability for each transmission."),
            BURST.with_text("Number of transmissions that are disturbed in a row."),
        ],
        text: "A bit is disturbed on the wire: error flag, retransmission, error counters up to error passive and bus-off (ISO 11898-1). `bus.log` shows the frame once it has been transmitted, and an error message of the bench for each change of a station's state. The bus load counts transmitted frames only, as a real interface does: disturbed transmissions only make them late.",
        ..BUS
    },
    Kind {
        name: "babble",
        actor: Actor::Foreign,
        keys: &[FOREIGN],
        text: "A foreign node sends without a pause. `bus.log` shows its frames.",
        ..BUS
    },
    Kind {
        name: "load",
        actor: Actor::Foreign,
        keys: &[
            FOREIGN
                .drawn(Drawn::Foreign(0x181))
                .with_text("Identifier of its frames."),
            Key::number("period_milliseconds", 0.1, 10_000.0)
                .drawn(Drawn::Between(0.2, 5.0))
                .with_text("Time between two frames."),
        ],
        text: "A foreign node sends at a constant rate. `bus.log` shows its frames.",
        ..BUS
    },
    Kind {
        name: "crash",
        actor: Actor::Process,
        keys: &[
            NODE,
            Key {
                name: "output",
                form: Form::Word(&[
                    (
                        "hold",
                        "The current stays: the amplifier keeps its last command, as do the outputs of an io node.",
                    ),
                    (
                        "zero",
                        "No current: the amplifier is switched off with its drive. The outputs of an io node are at rest.",
                    ),
                ]),
                need: Need::DefaultWord("zero"),
                drawn: Drawn::Word("hold"),
                text: "Behaviour of the drive's amplifier, or of the io node's outputs, meanwhile.",
            },
        ],
        text: "The node is dead, as without power. When the fault ends, it boots again, without memory.",
        ..AT_NODE
    },
    Kind {
        name: "hang",
        actor: Actor::Process,
        text: "The node hangs; then it continues as if no time had passed, with the first 32 of the frames that arrived meanwhile. The drive's amplifier keeps its current, an io node its outputs.",
        ..AT_NODE
    },
    Kind {
        name: "slow_cycle",
        touch: Touch::Late,
        is_rate_changed: true,
        keys: &[
            Key::number("delay_milliseconds", 0.0, 1_000.0)
                .drawn(Drawn::Between(0.1, 20.0))
                .with_text("Delay of its frames."),
            NODE,
        ],
        text: "The node is slow: it sends its frames later.",
        ..AT_NODE
    },
    Kind {
        name: "clock_drift",
        is_rate_changed: true,
        keys: &[
            Key::number("parts_per_million", -500_000.0, 500_000.0)
                .drawn(Drawn::Between(-5000.0, 5000.0))
                .with_text("Drift of the clock."),
            NODE,
        ],
        text: "The node's clock is fast, or slow if the drift is negative.",
        ..AT_NODE
    },
    Kind {
        name: "lost_heartbeat",
        touch: Touch::Heartbeats,
        text: "The node sends no heartbeats.",
        ..AT_NODE
    },
    Kind {
        name: "restart",
        time: Time::Instant,
        text: "The node restarts at once, without memory, as after a watchdog reset. The drive's current is 0 from then on.",
        ..AT_NODE
    },
    Kind {
        name: "nmt_stop",
        time: Time::Instant,
        actor: Actor::Message,
        text: "A foreign node sends the NMT command to stop the node; `bus.log` shows it.",
        ..AT_NODE
    },
    Kind {
        name: "late_boot",
        time: Time::Boot,
        keys: &[
            NODE,
            Key::number("delay_seconds", 0.0, 60.0)
                .drawn(Drawn::Between(0.0, 12.0))
                .with_text("Time by which it boots later than the others."),
        ],
        text: "The node boots late.",
        ..AT_NODE
    },
    Kind {
        name: "wrong_identity",
        time: Time::Boot,
        keys: &[Key::whole("product_code", 0, u32::MAX).with_text("Its product code (0x1018:02).")],
        text: "The drive is another product than in the controller's data sheet; the controller must refuse it.",
        ..AT_NODE
    },
    Kind {
        name: "wrong_node_id",
        time: Time::Boot,
        keys: &[Key::whole("node_id", 2, 127)
            .drawn(Drawn::FreeNodeId)
            .with_text("Its node-ID.")],
        text: "The drive has another node-ID than the controller expects.",
        ..AT_NODE
    },
    Kind {
        name: "offset",
        keys: &[Key::number("offset_{unit}", -1e6, 1e6)
            .drawn(Drawn::Between(-60.0, 60.0))
            .with_text("Offset that is added to the position.")],
        text: "The sensor reads too much or too little.",
        ..SENSOR
    },
    Kind {
        name: "drift",
        keys: &[Key::number("rate_{unit}_per_second", -1e6, 1e6)
            .drawn(Drawn::Between(-50.0, 50.0))
            .with_text("Rate of the drift.")],
        text: "The sensor's zero drifts while the fault lasts, and is correct again afterwards.",
        ..SENSOR
    },
    Kind {
        name: "noise",
        keys: &[Key::number("noise_{unit}_rms", 0.0, 1e6)
            .drawn(Drawn::Between(0.01, 5.0))
            .with_text("Standard deviation of the noise.")],
        text: "Normally distributed noise, in addition to the sensor's own.",
        ..SENSOR
    },
    Kind {
        name: "spikes",
        keys: &[
            Key::number("height_{unit}", 0.0, 1e6)
                .drawn(Drawn::Between(0.5, 60.0))
                .with_text("Height of a spike."),
            PROBABILITY.with_text("Probability of a spike in a sample."),
        ],
        text: "Single samples are off by a fixed height, upwards or downwards.",
        ..SENSOR
    },
    Kind {
        name: "lost_bits",
        keys: &[Key::whole("mask", 1, 16_777_215)
            .drawn(Drawn::Whole(1, 1023))
            .with_text("The bits, as a mask: 3 for the lowest two.")],
        text: "Bits of the converted number read 0.",
        ..SENSOR
    },
    Kind {
        name: "stuck",
        text: "The converted number does not change.",
        ..SENSOR
    },
    Kind {
        name: "saturated",
        keys: &[
            Key::number("{command}_{command_unit}_max", 0.0, 32_767_000.0)
                .drawn(Drawn::Between(0.01, 1.0))
                .with_text("Largest output that it still gives."),
        ],
        text: "The amplifier saturates below its largest current.",
        ..AMPLIFIER
    },
    Kind {
        name: "stuck_on",
        keys: &[
            Key::number("{command}_{command_unit}", -32_767_000.0, 32_767_000.0)
                .drawn(Drawn::Between(0.01, 1.0))
                .with_text("Output that acts, within the range of the amplifier."),
        ],
        text: "A current flows whatever is commanded.",
        ..AMPLIFIER
    },
    Kind {
        name: "dead",
        text: "No current flows whatever is commanded.",
        ..AMPLIFIER
    },
    Kind {
        name: "ageing",
        time: Time::Ends,
        keys: &[
            Key::number("resistance_factor", 0.1, 10.0)
                .needed(Need::Default(1.0))
                .drawn(Drawn::Between(0.5, 1.0))
                .with_text("Factor on the electrical resistance."),
            Key::number("recoverable_strain_factor", 0.0, 1.0)
                .needed(Need::Default(1.0))
                .drawn(Drawn::Between(0.5, 1.0))
                .with_text("Factor on the recoverable strain."),
        ],
        text: "The wire ages: while the fault lasts, the factors on its parameters move linearly from 1 to these values, where they stay.",
        ..PLANT
    },
    Kind {
        name: "broken_wire",
        text: "The wire is broken: it carries neither load nor current.",
        ..PLANT
    },
    Kind {
        name: "jammed_pulley",
        text: "The pulley does not move.",
        ..PLANT
    },
    Kind {
        name: "dropped_load",
        text: "The load has come off; disturbances that add a load have no effect.",
        ..PLANT
    },
];
