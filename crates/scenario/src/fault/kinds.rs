//! The table of faults. Schema, loader, checks, torture and book read its columns; the crates that play a fault know it by its
//! name.

/// Kind of fault: `[[fault.GROUP.NAME]]`.
#[derive(Debug)]
pub struct Kind {
    /// Part of a run in which it acts.
    pub group: Group,
    /// Unique name.
    pub name: &'static str,
    /// Time at which it acts.
    pub time: Time,
    /// Cyclic frames that it can keep from the bus or delay.
    pub touch: Touch,
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
    OfNode,
    /// The frames of its node, or of all nodes, which its `delay_milliseconds` delays.
    Late,
    /// The heartbeats of its node: the nodes that watch it may stop.
    Heartbeats,
}

/// Key of a fault's table.
#[derive(Clone, Copy, Debug)]
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
#[derive(Clone, Copy, Debug)]
pub enum Form {
    /// A number in a range.
    Number(f64, f64),
    /// A whole number in a range.
    Whole(u32, u32),
    /// One of these words, each with its description.
    Word(&'static [(&'static str, &'static str)]),
    /// The name of the controller or of a drive.
    Node,
    /// As `Node`, or canrig's own node.
    Station,
}

/// Whether a key may be left out.
#[derive(Clone, Copy, Debug)]
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
#[derive(Clone, Copy, Debug)]
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
    #[must_use]
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
                "Faults of the bus, in virtual time on the modelled bus only. A fault of frames hits those of one identifier or, without, all; each with a probability, and then so many of them in a row."
            }
            Self::Node => {
                "Faults of a drive's node or of the controller: how the node itself behaves, so `bus.log` shows what it still sends. Where a crash or hang of the controller meets a run in real time, it is a SIGKILL or SIGSTOP of its process; the other kinds are the same in all worlds."
            }
            Self::Sensor => {
                "Faults of the position sensor: before the drive, so `bus.log` shows the wrong position as the drive sends it. They act in this order: offset, drift, noise and spikes on the position before its conversion, then lost bits and stuck on the converter's number."
            }
            Self::Amplifier => {
                "Faults of the current amplifier: behind the drive; `bus.log` shows the current that really flows. Where several act at a time, the dead one wins, then the one stuck on."
            }
            Self::Plant => "Faults of wire and mechanics; `bus.log` shows their consequences only.",
        }
    }
}

impl PartialEq for Kind {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Kind {
    /// Returns the kind of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        KINDS.iter().find(|kind| kind.name == name)
    }

    /// Returns its key that names a node, if it has one.
    #[must_use]
    pub fn node_key(&self) -> Option<&'static Key> {
        let names_node = |key: &&Key| matches!(key.form, Form::Node | Form::Station);
        self.keys.iter().find(names_node)
    }

    /// Checks whether it happens to a drive. The drive need not be named if there is only one.
    #[must_use]
    pub fn is_of_a_drive(&self) -> bool {
        self.group != Group::Bus && self.node_key().is_none()
    }

    /// Returns the heading of its table.
    #[must_use]
    pub fn heading(&self) -> String {
        format!("[[fault.{}.{}]]", self.group.name(), self.name)
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
    text: "Station whose frames are hit.",
};
const IDENTIFIER: Key = Key {
    name: "identifier",
    form: Form::Whole(0, 2047),
    need: Need::Optional,
    drawn: Drawn::Identifier,
    text: "Only frames with this identifier.",
};
const PROBABILITY: Key = Key {
    name: "probability",
    form: Form::Number(0.0, 1.0),
    need: Need::Default(1.0),
    drawn: Drawn::Between(0.01, 1.0),
    text: "Probability for each frame.",
};
const BURST: Key = Key {
    name: "burst_frames",
    form: Form::Whole(1, 100_000),
    need: Need::Default(1.0),
    drawn: Drawn::Whole(1, 60),
    text: "Frames hit in a row.",
};
const FOREIGN: Key = Key {
    name: "identifier",
    form: Form::Whole(1, 2047),
    need: Need::Required,
    drawn: Drawn::Foreign(1),
    text: "Identifier of its frames; the lowest wins each arbitration.",
};

const fn number(
    name: &'static str,
    range: (f64, f64),
    drawn: (f64, f64),
    text: &'static str,
) -> Key {
    Key {
        name,
        form: Form::Number(range.0, range.1),
        need: Need::Required,
        drawn: Drawn::Between(drawn.0, drawn.1),
        text,
    }
}

const BUS: Kind = Kind {
    group: Group::Bus,
    name: "",
    time: Time::Lasts,
    touch: Touch::All,
    keys: &[],
    text: "",
};
const OF_NODE: Kind = Kind {
    group: Group::Node,
    touch: Touch::OfNode,
    keys: &[NODE],
    ..BUS
};
const SENSOR: Kind = Kind {
    group: Group::Sensor,
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

/// All kinds, in the order of the format. Torture draws the keys in the order in which they stand here.
pub static KINDS: &[Kind] = &[
    Kind {
        name: "lose",
        // The receiver does not answer a frame that it misses.
        touch: Touch::OfNode,
        keys: &[
            Key {
                name: "receiver",
                text: "Station that misses them.",
                ..SENDER
            },
            IDENTIFIER,
            PROBABILITY,
            BURST,
        ],
        text: "One receiver overruns: it misses frames that all others get. `bus.log` shows them.",
        ..BUS
    },
    Kind {
        name: "delay",
        touch: Touch::Late,
        keys: &[
            SENDER,
            number(
                "delay_milliseconds",
                (0.0, 10_000.0),
                (0.1, 20.0),
                "How long the frames wait.",
            ),
            IDENTIFIER,
            PROBABILITY,
            BURST,
        ],
        text: "The sender's frames wait before they may take part in the arbitration. `bus.log` shows them when they come.",
        ..BUS
    },
    Kind {
        name: "duplicate",
        touch: Touch::Nothing,
        keys: &[SENDER, IDENTIFIER, PROBABILITY, BURST],
        text: "A gateway between the sender and the bus sends frames twice. `bus.log` shows both.",
        ..BUS
    },
    Kind {
        name: "reorder",
        keys: &[SENDER, IDENTIFIER, PROBABILITY, BURST],
        text: "A gateway between the sender and the bus lets the sender's next frame overtake. `bus.log` shows them in the new order.",
        ..BUS
    },
    Kind {
        name: "corrupt",
        keys: &[
            SENDER,
            Key {
                name: "inverted_bits",
                form: Form::Whole(1, 64),
                need: Need::Default(1.0),
                drawn: Drawn::Whole(1, 8),
                text: "Bits that are inverted, at random places.",
            },
            IDENTIFIER,
            PROBABILITY,
            BURST,
        ],
        text: "A gateway between the sender and the bus changes payloads; the CRC on the bus is right. `bus.log` shows the changed frames.",
        ..BUS
    },
    Kind {
        name: "bit_error",
        keys: &[
            Key {
                need: Need::Optional,
                drawn: Drawn::PerhapsStation,
                text: "Only while this station sends.",
                ..SENDER
            },
            IDENTIFIER,
            Key {
                text: "Probability for each transmission.",
                ..PROBABILITY
            },
            Key {
                text: "Transmissions disturbed in a row.",
                ..BURST
            },
        ],
        text: "A bit is disturbed on the wire: error flag, retransmission, error counters up to error passive and bus-off (ISO 11898-1). `bus.log` shows the frame when it has passed, and an error message of the bench's for each change of a station's state. The bus load counts frames that passed, as on a real interface: what was disturbed only makes them late.",
        ..BUS
    },
    Kind {
        name: "babble",
        keys: &[FOREIGN],
        text: "A foreign node sends without a pause. `bus.log` shows its frames.",
        ..BUS
    },
    Kind {
        name: "load",
        keys: &[
            Key {
                drawn: Drawn::Foreign(0x181),
                text: "Identifier of its frames.",
                ..FOREIGN
            },
            number(
                "period_milliseconds",
                (0.1, 10_000.0),
                (0.2, 5.0),
                "Time between two frames.",
            ),
        ],
        text: "A foreign node sends at an even rate. `bus.log` shows its frames.",
        ..BUS
    },
    Kind {
        name: "crash",
        keys: &[
            NODE,
            Key {
                name: "output",
                form: Form::Word(&[
                    (
                        "hold",
                        "The current stays: the amplifier keeps its last command.",
                    ),
                    (
                        "zero",
                        "No current: the amplifier is switched off with its drive.",
                    ),
                ]),
                need: Need::DefaultWord("zero"),
                drawn: Drawn::Word("hold"),
                text: "What the drive's amplifier does meanwhile.",
            },
        ],
        text: "The node is dead, as without power; where the fault ends it boots anew, without memory.",
        ..OF_NODE
    },
    Kind {
        name: "hang",
        text: "The node does nothing; then it goes on as if no time had passed, with the first 32 of the frames that came meanwhile. The drive's amplifier keeps its current.",
        ..OF_NODE
    },
    Kind {
        name: "slow_cycle",
        touch: Touch::Late,
        keys: &[
            number(
                "delay_milliseconds",
                (0.0, 1_000.0),
                (0.1, 20.0),
                "How much later.",
            ),
            NODE,
        ],
        text: "The node is slow: its frames leave it later.",
        ..OF_NODE
    },
    Kind {
        name: "clock_drift",
        keys: &[
            number(
                "parts_per_million",
                (-500_000.0, 500_000.0),
                (-5000.0, 5000.0),
                "Drift of the clock.",
            ),
            NODE,
        ],
        text: "The node's clock is fast (or slow, if negative).",
        ..OF_NODE
    },
    Kind {
        name: "lost_heartbeat",
        touch: Touch::Heartbeats,
        text: "The node's heartbeats do not leave it.",
        ..OF_NODE
    },
    Kind {
        name: "restart",
        time: Time::Instant,
        text: "The node starts anew at once, without memory, as after a watchdog reset. The drive's current is 0 from then on.",
        ..OF_NODE
    },
    Kind {
        name: "nmt_stop",
        time: Time::Instant,
        text: "Somebody on the bus orders the node to stop; `bus.log` shows the order.",
        ..OF_NODE
    },
    Kind {
        name: "late_boot",
        time: Time::Boot,
        keys: &[
            NODE,
            number(
                "delay_seconds",
                (0.0, 60.0),
                (0.0, 12.0),
                "How much later than the others it boots.",
            ),
        ],
        text: "The node boots late.",
        ..OF_NODE
    },
    Kind {
        name: "wrong_identity",
        time: Time::Boot,
        keys: &[Key {
            name: "product_code",
            form: Form::Whole(0, u32::MAX),
            need: Need::Required,
            drawn: Drawn::Whole(0, u32::MAX),
            text: "Its product code (0x1018:02).",
        }],
        text: "The drive is not the one of the controller's data sheet; the controller must refuse it.",
        ..OF_NODE
    },
    Kind {
        name: "wrong_node_id",
        time: Time::Boot,
        keys: &[Key {
            name: "node_id",
            form: Form::Whole(2, 127),
            need: Need::Required,
            drawn: Drawn::FreeNodeId,
            text: "Its node-ID.",
        }],
        text: "The drive has another node-ID than the controller expects.",
        ..OF_NODE
    },
    Kind {
        name: "offset",
        keys: &[number(
            "offset_millimetres",
            (-1e6, 1e6),
            (-60.0, 60.0),
            "Added to the position.",
        )],
        text: "The sensor reads too much or too little.",
        ..SENSOR
    },
    Kind {
        name: "drift",
        keys: &[number(
            "rate_millimetres_per_second",
            (-1e6, 1e6),
            (-50.0, 50.0),
            "How fast the zero wanders.",
        )],
        text: "The sensor's zero wanders away while the fault lasts, and is back after it.",
        ..SENSOR
    },
    Kind {
        name: "noise",
        keys: &[number(
            "noise_millimetres_rms",
            (0.0, 1e6),
            (0.01, 5.0),
            "Standard deviation of the noise.",
        )],
        text: "Normal noise on top of the plant's own.",
        ..SENSOR
    },
    Kind {
        name: "spikes",
        keys: &[
            number(
                "height_millimetres",
                (0.0, 1e6),
                (0.5, 60.0),
                "Height of a spike.",
            ),
            Key {
                text: "Probability of a spike in a sample.",
                ..PROBABILITY
            },
        ],
        text: "Single samples are off by a fixed height, upwards or downwards.",
        ..SENSOR
    },
    Kind {
        name: "lost_bits",
        keys: &[Key {
            name: "mask",
            form: Form::Whole(1, 16_777_215),
            need: Need::Required,
            drawn: Drawn::Whole(1, 1023),
            text: "The bits, as a mask: 3 for the lowest two.",
        }],
        text: "Bits of the converter's number read 0.",
        ..SENSOR
    },
    Kind {
        name: "stuck",
        text: "The converter's number stays as it is.",
        ..SENSOR
    },
    Kind {
        name: "saturated",
        keys: &[number(
            "current_amperes_max",
            (0.0, 32_767_000.0),
            (0.01, 1.0),
            "Largest current that it gives.",
        )],
        text: "The amplifier gives less than its largest current.",
        ..AMPLIFIER
    },
    Kind {
        name: "stuck_on",
        keys: &[number(
            "current_amperes",
            (-32_767_000.0, 32_767_000.0),
            (0.01, 1.0),
            "Current that flows, within the range of the amplifier.",
        )],
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
            Key {
                need: Need::Default(1.0),
                ..number(
                    "resistance_factor",
                    (0.1, 10.0),
                    (0.5, 1.0),
                    "Factor on the electrical resistance.",
                )
            },
            Key {
                need: Need::Default(1.0),
                ..number(
                    "recoverable_strain_factor",
                    (0.0, 1.0),
                    (0.5, 1.0),
                    "Factor on the recoverable strain.",
                )
            },
        ],
        text: "The wire ages: its parameters move evenly from 1 to their factors while the fault lasts, and stay.",
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
        text: "The load has come off; disturbances that add one do nothing.",
        ..PLANT
    },
];
