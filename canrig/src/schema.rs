//! `canrig schema`: the JSON Schema of scenario and rig files, for editors.

use clap::Args;

use runner::console::print;
use runner::exit::Exit;

/// Arguments of `schema`.
#[derive(Args, Debug)]
pub(crate) struct SchemaArgs {
    /// The key `schema` of the files: 1 for one drive, 2 for nodes by name
    #[arg(default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=2))]
    pub number: u8,
    /// Print the schema of rig files instead
    #[arg(long)]
    pub rig: bool,
}

/// Prints the schema.
#[must_use]
pub(crate) fn schema(args: &SchemaArgs) -> Exit {
    print(&match (args.number, args.rig) {
        (2, true) => scenario::schema::rig_json_schema_2(),
        (2, false) => scenario::schema::json_schema_2(),
        (_, true) => scenario::schema::rig_json_schema(),
        (_, false) => scenario::schema::json_schema(),
    });
    Exit::Pass
}
