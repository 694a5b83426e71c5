//! The layout that the viewer opens the recording with.
//!
//! Logged as raw archetypes, since the SDK's typed layout cannot yet link time axes or place legends.

use std::collections::BTreeSet;

use rerun::datatypes::{Bool, Float32, Range1D, Range2D, Uuid};
use rerun::external::re_log_types::{BlueprintActivationCommand, LogMsg};
use rerun::external::re_sdk_types::blueprint::archetypes::{
    ContainerBlueprint, PanelBlueprint, PlotLegend, TextLogColumns, TimeAxis, TimePanelBlueprint,
    ViewBlueprint, ViewContents, ViewportBlueprint, VisualBounds2D,
};
use rerun::external::re_sdk_types::blueprint::components::{
    AutoLayout, AutoViews, ColumnShare, ContainerKind, Corner2D, IncludedContent, LinkAxis,
    PanelState, PlayState, QueryExpression, RootContainer, RowShare, TextLogColumn, TimelineName,
};
use rerun::external::re_sdk_types::blueprint::datatypes::{self, TextLogColumnKind};
use rerun::{AsComponents, RecordingStream, RecordingStreamBuilder, RecordingStreamError};

use super::{APPLICATION, RUN_TIME, hysteresis};

type Result<T> = std::result::Result<T, RecordingStreamError>;

/// Sends the layout ahead of the recording's data.
pub(super) fn send(recording: &RecordingStream, groups: &BTreeSet<&str>) -> Result<()> {
    let (stream, messages) = RecordingStreamBuilder::new(APPLICATION)
        .enabled(true)
        .recording_id("canrig layout")
        .blueprint()
        .memory()?;
    stream.set_log_time_enabled(false);
    stream.set_time_sequence("blueprint", 0);
    let mut layout = Layout {
        stream: &stream,
        places: 0,
    };
    layout.build(groups)?;
    let messages = messages.take();
    let id = messages.iter().find_map(|message| match message {
        LogMsg::SetStoreInfo(info) => Some(info.info.store_id.clone()),
        _ => None,
    });
    if let Some(blueprint_id) = id {
        let command = BlueprintActivationCommand {
            blueprint_id,
            make_active: true,
            make_default: true,
        };
        recording.send_blueprint(messages, command);
    }
    Ok(())
}

/// A view or container, and its share of the room.
struct Place {
    id: Uuid,
    path: String,
    share: f32,
}

struct Layout<'a> {
    stream: &'a RecordingStream,
    places: u8,
}

impl Layout<'_> {
    fn build(&mut self, groups: &BTreeSet<&str>) -> Result<()> {
        let has = |group| groups.contains(group);
        let mut left = Vec::new();
        left.push(self.plot("Position (mm)", "position", 2.2)?);
        if has("error") {
            left.push(self.plot("Error (mm)", "error", 1.2)?);
        }
        left.push(self.plot("Current (A)", "current", 1.2)?);
        if has("disturbance") {
            left.push(self.plot("Disturbance", "disturbance", 0.8)?);
        }
        let events = self.event_log("events", 1.0)?;
        let verdict = self.view("TextDocument", "Verdict", "verdict", 1.0)?;
        left.push(self.container(ContainerKind::Horizontal, vec![events, verdict], 1.6)?);

        let mut right = Vec::new();
        if has("temperature") {
            right.push(self.plot("Wire temperature (°C)", "temperature", 1.0)?);
        }
        if has("martensite_fraction") {
            right.push(self.plot("Martensite fraction", "martensite_fraction", 1.0)?);
        }
        if has("hysteresis") {
            right.push(self.hysteresis(1.7)?);
        }
        if has("sliding_variable") {
            let variable = self.plot("Sliding variable (m/s²)", "sliding_variable", 1.0)?;
            let law = self.plot("Parts of the law (A²)", "law", 1.0)?;
            right.push(self.container(ContainerKind::Tabs, vec![variable, law], 1.2)?);
        }
        let mut columns = vec![self.container(ContainerKind::Vertical, left, 3.0)?];
        if !right.is_empty() {
            columns.push(self.container(ContainerKind::Vertical, right, 2.0)?);
        }
        let root = self.container(ContainerKind::Horizontal, columns, 1.0)?;
        self.viewport(&root)
    }

    /// Signals of one group over time; the time axes of all plots move together.
    fn plot(&mut self, title: &str, group: &str, share: f32) -> Result<Place> {
        let place = self.view("TimeSeries", title, group, share)?;
        self.log(
            &format!("{}/PlotLegend", place.path),
            &PlotLegend::new().with_corner(Corner2D::LeftTop),
        )?;
        self.log(
            &format!("{}/TimeAxis", place.path),
            &TimeAxis::new().with_link(LinkAxis::LinkToGlobal),
        )?;
        Ok(place)
    }

    /// Time, level and text; the path would be the same in each row.
    fn event_log(&mut self, group: &str, share: f32) -> Result<Place> {
        let place = self.view("TextLog", "Events", group, share)?;
        let columns = [TextLogColumnKind::LogLevel, TextLogColumnKind::Body];
        let columns = columns.map(|kind| {
            TextLogColumn(datatypes::TextLogColumn {
                visible: Bool(true),
                kind,
            })
        });
        let columns = TextLogColumns::new().with_text_log_columns(columns);
        self.log(&format!("{}/TextLogColumns", place.path), &columns)?;
        Ok(place)
    }

    fn hysteresis(&mut self, share: f32) -> Result<Place> {
        let place = self.view(
            "2D",
            "Martensite fraction over temperature",
            "hysteresis",
            share,
        )?;
        let bounds = Range2D {
            x_range: Range1D([-0.12 * hysteresis::WIDTH, 1.08 * hysteresis::WIDTH]),
            y_range: Range1D([-0.08 * hysteresis::HEIGHT, 1.16 * hysteresis::HEIGHT]),
        };
        self.log(
            &format!("{}/VisualBounds2D", place.path),
            &VisualBounds2D::new(bounds),
        )?;
        Ok(place)
    }

    fn view(&mut self, class: &str, title: &str, group: &str, share: f32) -> Result<Place> {
        let id = self.next_id();
        let path = format!("view/{id}");
        let view = ViewBlueprint::new(class)
            .with_display_name(title)
            .with_space_origin(format!("/{group}"));
        self.log(&path, &view)?;
        let contents = ViewContents::new([QueryExpression("$origin/**".into())]);
        self.log(&format!("{path}/ViewContents"), &contents)?;
        Ok(Place { id, path, share })
    }

    fn container(
        &mut self,
        kind: ContainerKind,
        contents: Vec<Place>,
        share: f32,
    ) -> Result<Place> {
        let id = self.next_id();
        let path = format!("container/{id}");
        let included = contents
            .iter()
            .map(|place| IncludedContent(place.path.as_str().into()));
        let shares = contents.iter().map(|place| Float32(place.share));
        let container = ContainerBlueprint::new(kind).with_contents(included);
        let container = match kind {
            ContainerKind::Horizontal => container.with_col_shares(shares.map(ColumnShare)),
            ContainerKind::Vertical => container.with_row_shares(shares.map(RowShare)),
            ContainerKind::Tabs | ContainerKind::Grid => container,
        };
        self.log(&path, &container)?;
        Ok(Place { id, path, share })
    }

    fn viewport(&self, root: &Place) -> Result<()> {
        let viewport = ViewportBlueprint::new()
            .with_root_container(RootContainer(root.id))
            .with_auto_layout(AutoLayout(Bool(false)))
            .with_auto_views(AutoViews(Bool(false)));
        self.log("viewport", &viewport)?;
        let collapsed = PanelBlueprint::new().with_state(PanelState::Collapsed);
        self.log("blueprint_panel", &collapsed)?;
        self.log("selection_panel", &collapsed)?;
        let time_panel = TimePanelBlueprint::new()
            .with_state(PanelState::Collapsed)
            .with_timeline(TimelineName(RUN_TIME.into()))
            .with_play_state(PlayState::Paused);
        self.log("time_panel", &time_panel)
    }

    fn log(&self, path: &str, what: &dyn AsComponents) -> Result<()> {
        self.stream.log(path, what)
    }

    /// Any names do that differ.
    fn next_id(&mut self) -> Uuid {
        self.places += 1;
        let mut bytes = *b"canrig layout 00";
        bytes[15] = self.places;
        Uuid { bytes }
    }
}
