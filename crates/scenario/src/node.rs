//! The nodes of a run, by name, node-ID and part.

use std::borrow::Cow;

use crate::rig::nodes::CONTROLLER_NODE_ID;

/// A node of a run.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct Node {
    /// Its name.
    pub name: String,
    /// Its node-ID; 0 of canrig's own node.
    pub id: u8,
    /// Its part in the run.
    pub part: Part,
}

/// The part of a node in a run.
#[derive(Clone, Copy, Debug, Eq, Ord, PartialEq, PartialOrd)]
pub enum Part {
    /// The manager.
    Controller,
    /// A drive.
    Drive,
    /// A node with outputs that act on a plant.
    Io,
    /// canrig's own node, which can stop the drives.
    Bench,
}

impl Part {
    /// As rig files say it: `kind = "drive"`.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Controller => "controller",
            Self::Drive => "drive",
            Self::Io => "io",
            Self::Bench => "bench",
        }
    }
}

impl Node {
    /// A node.
    #[must_use]
    pub fn new(name: &str, id: u8, part: Part) -> Self {
        Self {
            name: name.to_owned(),
            id,
            part,
        }
    }

    /// It within a sentence: `the drive` for a node that is called after its part, else its name.
    #[must_use]
    pub fn in_words(&self) -> Cow<'_, str> {
        if self.name == self.part.word() {
            format!("the {}", self.name).into()
        } else {
            self.name.as_str().into()
        }
    }
}

/// The nodes of a loop.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct LoopNodes {
    /// The controller, which leads all loops.
    pub controller: Node,
    /// Its drive.
    pub drive: Node,
    /// The drive whose signal it follows: mostly its own.
    pub followed: Node,
    /// The io nodes whose commands are recorded in it: those whose first drive its own is.
    pub io: Vec<Node>,
}

impl LoopNodes {
    /// Its nodes in the order controller, drive, io nodes.
    pub fn all(&self) -> impl Iterator<Item = &Node> {
        [&self.controller, &self.drive].into_iter().chain(&self.io)
    }

    /// The node with a part in the loop.
    #[must_use]
    pub fn of(&self, part: Part) -> Option<&Node> {
        self.all().find(|node| node.part == part)
    }
}

/// The nodes of the rig that ships.
impl Default for LoopNodes {
    fn default() -> Self {
        let named = |part: Part, id| Node::new(part.word(), id, part);
        let drive = named(Part::Drive, 0x10);
        Self {
            controller: named(Part::Controller, CONTROLLER_NODE_ID),
            followed: drive.clone(),
            drive,
            io: vec![Node::new("disturbance", 0x11, Part::Io)],
        }
    }
}
