//! The nodes of a bench by name: the data sheet of each, and its frames.

use canopen::eds;
use dbc::data_sheets::{AnalogueOutput, OfDrive};
use dbc::loops::NodesByName;
use dbc::{DISTURBANCE_EDS, DRIVE_EDS, Database, data_sheets};
use scenario::port::Unit;

use crate::data_sheet::{CONTROLLER_NODE_ID, DataSheet, DataSheetError, rig_data_sheets};
use crate::setup::Setup;

/// The EDS of one node.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct NodeSheet {
    /// What the rig calls the node.
    pub name: String,
    /// Its node-ID.
    pub node_id: u8,
    /// The EDS.
    pub text: String,
}

impl NodeSheet {
    /// The name of its file.
    #[must_use]
    pub fn file_name(&self) -> String {
        format!("{}.eds", self.name)
    }
}

/// The EDS of each node of these loops, which share a bus, in the order of the node-IDs.
#[must_use]
pub fn node_sheets(setups: &[Setup]) -> Vec<NodeSheet> {
    let loops = setups.iter().map(of_loop);
    let mut sheets = Vec::from_iter(loops.flatten());
    let (drives, modules): (Vec<_>, Vec<_>) = setups.iter().map(node_ids).unzip();
    let mut servers = Vec::new();
    for id in drives.into_iter().chain(modules.into_iter().flatten()) {
        if !servers.contains(&id) {
            servers.push(id);
        }
    }
    sheets.extend(setups.first().map(|setup| controller(setup, &servers)));
    sheets.sort_by_key(|sheet| sheet.node_id);
    sheets.dedup_by_key(|sheet| sheet.node_id);
    sheets
}

/// The node-IDs of a loop's drive and of the module that acts on its plant, where there is one.
fn node_ids(setup: &Setup) -> (u8, Option<u8>) {
    let (_, _, disturbance) = setup.node_names();
    let (drive, module) = match &setup.rig {
        Some(rig) => (rig.drive.node_id().get(), Some(rig.file.fan.node_id)),
        None => (setup.place.drive_node_id, setup.place.disturbance_node_id),
    };
    (drive, disturbance.and(module))
}

fn sheet(name: &str, node_id: u8, eds: &str, of_drive: Option<&OfDrive>) -> NodeSheet {
    NodeSheet {
        name: name.to_owned(),
        node_id,
        text: data_sheets::of_node(eds, name, node_id, of_drive),
    }
}

/// The EDS of the controller, which talks to these nodes.
fn controller(setup: &Setup, servers: &[u8]) -> NodeSheet {
    let (name, ..) = setup.node_names();
    let eds = data_sheets::of_controller(servers);
    sheet(name, CONTROLLER_NODE_ID, &eds, None)
}

fn of_loop(setup: &Setup) -> impl Iterator<Item = NodeSheet> + use<> {
    let (_, drive, disturbance) = setup.node_names();
    let place = &setup.place;
    let (drive_id, module_id) = node_ids(setup);
    let drive = match &setup.rig {
        // The maker's, who says nothing of this rig.
        Some(rig) => NodeSheet {
            name: drive.to_owned(),
            node_id: drive_id,
            text: rig.eds.clone(),
        },
        None => {
            let unit = &setup.scenario.wiring.unit;
            let si_position =
                (*unit != Unit::Millimetres).then(|| (unit.si_position(), unit.word().to_owned()));
            let of_drive = OfDrive {
                truth: place.truth_pace(),
                si_position,
            };
            sheet(drive, drive_id, DRIVE_EDS, Some(&of_drive))
        }
    };
    let module = disturbance.zip(module_id);
    let outputs = setup.io_outputs().iter().map(|output| AnalogueOutput {
        place: output.place,
        name: output.name.clone(),
        at_rest: output.raw(output.at_rest),
    });
    let module_eds = data_sheets::with_outputs(DISTURBANCE_EDS, &Vec::from_iter(outputs));
    let module = module.map(|(name, node_id)| sheet(name, node_id, &module_eds, None));
    [drive].into_iter().chain(module)
}

/// All nodes of these loops by node-ID, as the rig calls them.
pub(crate) fn names_by_id(setups: &[Setup]) -> impl Iterator<Item = (u8, &str)> {
    setups.iter().flat_map(|setup| {
        let (controller, drive, disturbance) = setup.node_names();
        let (drive_id, module_id) = node_ids(setup);
        let nodes = [(CONTROLLER_NODE_ID, controller), (drive_id, drive)];
        nodes.into_iter().chain(module_id.zip(disturbance))
    })
}

/// The nodes of a bench as tools know them.
#[derive(Clone, Debug)]
pub struct NamedNodes {
    /// Their data sheets.
    pub sheets: Vec<DataSheet>,
    /// What their frames mean, each message by the name of its node.
    pub database: Database,
}

impl NamedNodes {
    /// Those of the rig that ships.
    #[must_use]
    pub fn shipped() -> Self {
        Self {
            sheets: rig_data_sheets(),
            database: Database::shipped().clone(),
        }
    }

    /// Those of these loops, which share a bus.
    ///
    /// # Errors
    /// An EDS is wrong.
    ///
    /// # Panics
    /// There is no loop.
    pub fn of(setups: &[Setup]) -> Result<Self, DataSheetError> {
        let sheets = node_sheets(setups).into_iter().map(|sheet| {
            let file = sheet.file_name();
            let NodeSheet {
                name,
                node_id,
                text,
            } = sheet;
            let parsed = eds::parse(&text, node_id).map_err(|error| DataSheetError::Eds {
                path: file.clone().into(),
                error: Box::new(error),
            });
            Ok(DataSheet {
                name: file,
                node_name: name,
                node_id,
                dictionary: parsed?.dictionary,
            })
        });
        let names = setups.iter().map(|setup| {
            let (_, drive, disturbance) = setup.node_names();
            let of_loop = setup.loop_name.as_ref();
            NodesByName {
                of_loop: of_loop.map_or("", |names| &names.name),
                drive,
                disturbance,
            }
        });
        let first = &setups[0];
        let (controller, ..) = first.node_names();
        Ok(Self {
            sheets: sheets.collect::<Result<_, DataSheetError>>()?,
            database: first.database.by_node(controller, &Vec::from_iter(names)),
        })
    }
}
