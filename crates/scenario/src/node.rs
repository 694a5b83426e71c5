//! The nodes of a run: what each of them is, and who plays it.
//!
//! The resolver makes the list once, from the rig and the names of the nodes that somebody else
//! plays. From then on code names a node by its [`NodeIndex`], its place in this list: plans,
//! faults, wirings, recordings and attributions all mean the same list.

use std::borrow::Cow;
use std::iter;
use std::ops::Index;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use dbc::names::BENCH;

/// Place of a node in the list of its run. It is never sent, and no file has it.
#[derive(Clone, Copy, Debug, Eq, Ord, PartialEq, PartialOrd)]
pub struct NodeIndex(u8);

/// Node of a run.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct Node {
    /// Name of the node.
    pub name: String,
    /// How it takes part in the traffic on the bus.
    pub speaks: Speaks,
    /// Player of the node.
    pub player: Player,
    /// Whether the run tests it: canrig does not play it, or its law is a process.
    pub is_under_test: bool,
}

/// How a node takes part in the traffic on the bus.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Speaks {
    /// It is a node of CANopen (CiA 301).
    Canopen(Canopen),
    /// canrig's own node, which can stop the drives and is in no rig file.
    Bench,
}

/// Facts of a CANopen node.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Canopen {
    /// Node-ID.
    pub id: u8,
    /// Profile that it serves.
    pub profile: Profile,
}

/// Kind of a node.
#[derive(Clone, Copy, Debug, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "NodeKind")]
pub enum Profile {
    /// SYNC producer, NMT master, and the laws of all loops. A bus has one.
    #[serde(rename = "controller")]
    Manager,
    /// An emulated CiA 402 drive with amplifier and sensor.
    Drive,
    /// An emulated CiA 401 node with outputs that act on a plant, such as a fan and a load.
    Io,
}

/// Player of a node.
#[derive(Clone, Debug, Eq, PartialEq)]
pub enum Player {
    /// The emulator of the plants that the node moves.
    Emulator,
    /// canrig's controller, with its laws.
    Controller,
    /// The bench.
    Bench,
    /// A program that the bench starts.
    Program(NodeProgram),
    /// Somebody else: the node is expected on the bus.
    Expected,
}

/// Program that plays a node.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct NodeProgram {
    /// Program and its arguments.
    pub command: Vec<String>,
    /// Name of the file that names the program, relative to the scenario; empty for the scenario itself.
    pub named_in: String,
}

impl Profile {
    /// Returns its word in rig files: `kind = "drive"`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Manager => "controller",
            Self::Drive => "drive",
            Self::Io => "io",
        }
    }
}

impl Node {
    /// Makes a CANopen node that canrig plays.
    pub fn canopen(name: &str, id: u8, profile: Profile) -> Self {
        Self {
            name: name.to_owned(),
            speaks: Speaks::Canopen(Canopen { id, profile }),
            player: match profile {
                Profile::Manager => Player::Controller,
                Profile::Drive | Profile::Io => Player::Emulator,
            },
            is_under_test: false,
        }
    }

    /// Makes canrig's own node.
    fn bench() -> Self {
        Self {
            name: BENCH.to_owned(),
            speaks: Speaks::Bench,
            player: Player::Bench,
            is_under_test: false,
        }
    }

    /// Returns the node-ID; 0, with which NMT commands address all nodes, for a node without one.
    pub fn id(&self) -> u8 {
        match self.speaks {
            Speaks::Canopen(canopen) => canopen.id,
            Speaks::Bench => 0,
        }
    }

    /// Returns the profile of a CANopen node.
    pub fn profile(&self) -> Option<Profile> {
        match self.speaks {
            Speaks::Canopen(canopen) => Some(canopen.profile),
            Speaks::Bench => None,
        }
    }

    /// Checks whether it is a drive.
    pub fn is_drive(&self) -> bool {
        self.profile() == Some(Profile::Drive)
    }

    /// Checks whether it is an io node.
    pub fn is_io(&self) -> bool {
        self.profile() == Some(Profile::Io)
    }

    /// Returns the word for what it is: `drive`.
    pub fn word(&self) -> &'static str {
        self.profile().map_or(BENCH, Profile::word)
    }

    /// Checks whether canrig plays it.
    pub fn is_ours(&self) -> bool {
        !self.is_external()
    }

    /// Checks whether canrig does not play it: it is a program, or expected on the bus.
    pub fn is_external(&self) -> bool {
        matches!(self.player, Player::Program(_) | Player::Expected)
    }

    /// Returns the program that plays it.
    pub fn program(&self) -> Option<&NodeProgram> {
        match &self.player {
            Player::Program(program) => Some(program),
            _ => None,
        }
    }

    /// Gives it to another player.
    #[must_use]
    pub fn played_by(mut self, player: Player) -> Self {
        self.player = player;
        self.is_under_test |= self.is_external();
        self
    }

    /// Returns its name within a sentence: `the drive` for a node that is called what it is, else the name.
    pub fn in_sentence(&self) -> Cow<'_, str> {
        if self.name == self.word() {
            format!("the {}", self.name).into()
        } else {
            self.name.as_str().into()
        }
    }
}

/// The nodes of a run in the order of their names; the last one is the bench. Clones share them.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct Nodes {
    all: Arc<[Node]>,
    manager: NodeIndex,
}

impl Nodes {
    /// Drive of a wiring without a rig.
    pub(crate) const DEFAULT_DRIVE: NodeIndex = NodeIndex(1);

    /// Makes the list of nodes that are in the order of their names, with the bench behind them;
    /// `None` if none of them is the manager.
    pub fn new(nodes: impl IntoIterator<Item = Node>) -> Option<Self> {
        let all = Vec::from_iter(nodes.into_iter().chain(iter::once(Node::bench())));
        let is_manager = |node: &Node| node.profile() == Some(Profile::Manager);
        let manager = all.iter().position(is_manager)?;
        Some(Self {
            manager: NodeIndex(u8::try_from(manager).ok()?),
            all: all.into(),
        })
    }

    /// Returns the same nodes, as changed by a function.
    #[must_use]
    pub fn changed(&self, change: impl Fn(NodeIndex, &mut Node)) -> Self {
        let mut all = self.all.to_vec();
        for (place, node) in (0..).zip(&mut all) {
            change(NodeIndex(place), node);
        }
        Self {
            all: all.into(),
            ..*self
        }
    }

    /// Returns all nodes with their indices.
    pub fn iter(&self) -> impl Iterator<Item = (NodeIndex, &Node)> {
        (0..).map(NodeIndex).zip(&*self.all)
    }

    /// Returns the node of a name.
    pub fn find(&self, name: &str) -> Option<NodeIndex> {
        let mut all = self.iter();
        all.find(|(_, node)| node.name == name)
            .map(|(index, _)| index)
    }

    /// Returns the CANopen node with a node-ID.
    pub fn with_id(&self, id: u8) -> Option<NodeIndex> {
        let mut canopen = self.iter().filter(|(_, node)| node.profile().is_some());
        canopen
            .find(|(_, node)| node.id() == id)
            .map(|(index, _)| index)
    }

    /// Returns the manager, which leads all loops.
    pub fn manager(&self) -> NodeIndex {
        self.manager
    }
}

/// Nodes of a wiring without a rig: a controller, and a drive at [`Nodes::DEFAULT_DRIVE`].
impl Default for Nodes {
    fn default() -> Self {
        let nodes = [(Profile::Manager, 0x01), (Profile::Drive, 0x10)];
        let nodes = nodes.map(|(profile, id)| Node::canopen(profile.word(), id, profile));
        Self {
            all: nodes.into_iter().chain([Node::bench()]).collect(),
            manager: NodeIndex(0),
        }
    }
}

impl Index<NodeIndex> for Nodes {
    type Output = Node;

    fn index(&self, index: NodeIndex) -> &Node {
        &self.all[usize::from(index.0)]
    }
}
