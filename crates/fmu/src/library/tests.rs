use std::fs;
use std::path::PathBuf;
use std::process::Command;

use super::*;

/// A library of FMI 3.0 with a variable of each type, which starts at -2. That of `Int32` says what the FMU asks for.
const OF_EACH_TYPE: &str = r"
typedef unsigned Reference;
typedef unsigned long Size;
#define VARIABLE(name, type) \
    static type name = (type)-2; \
    int fmi3Get##name(void *fmu, const Reference *of, Size n, type *value, Size m) { *value = name; return 0; } \
    int fmi3Set##name(void *fmu, const Reference *of, Size n, const type *value, Size m) { name = *value; return 0; }
VARIABLE(Float64, double) VARIABLE(Float32, float)
VARIABLE(Int8, signed char) VARIABLE(UInt8, unsigned char) VARIABLE(Int16, short) VARIABLE(UInt16, unsigned short)
VARIABLE(Int32, int) VARIABLE(UInt32, unsigned) VARIABLE(Int64, long) VARIABLE(UInt64, unsigned long)
VARIABLE(Boolean, _Bool)

#define PLAIN(name) int fmi3##name(void) { return 0; }
PLAIN(EnterInitializationMode) PLAIN(ExitInitializationMode) PLAIN(EnterEventMode) PLAIN(EnterStepMode) PLAIN(Terminate)
void *fmi3InstantiateCoSimulation(void) { return &Int32; }
void fmi3FreeInstance(void *fmu) {}

int fmi3DoStep(void *fmu, double from, double lasts, _Bool no_set, _Bool *event, _Bool *ends, _Bool *early, double *last) {
    *event = *early = Int32 == 1;
    *ends = Int32 == 2;
    if (*early) *last = from + lasts / 2;
    return 0;
}

int fmi3UpdateDiscreteStates(void *fmu, _Bool *again, _Bool *ends, _Bool *nominals, _Bool *values, _Bool *has, double *next) {
    *again = *has = Int32 == 1;
    *ends = Int32 == 2;
    *next = 2.0;
    return 0;
}
";

/// Compiles a shared library.
fn compiled(folder: &Path, name: &str, code: &str) -> PathBuf {
    let [source, library] = ["c", "so"].map(|end| folder.join(format!("{name}.{end}")));
    fs::write(&source, code).unwrap();
    let mut compiler = Command::new("cc");
    compiler.args(["-shared", "-fPIC", "-o"]);
    let compiled = compiler.arg(&library).arg(&source).output().unwrap();
    assert!(compiled.status.success(), "{compiled:?}");
    library
}

fn of_each_type(folder: &Path) -> Box<dyn Slave> {
    let binaries = folder.join("binaries").join(Version::Three.platform());
    fs::create_dir_all(&binaries).unwrap();
    compiled(&binaries, "types", OF_EACH_TYPE);
    let xml = r#"<fmiModelDescription fmiVersion="3.0" modelName="types" instantiationToken="t">
        <CoSimulation modelIdentifier="types" hasEventMode="true"/></fmiModelDescription>"#;
    instantiate(folder, &Description::parse(xml).unwrap(), c"types").unwrap()
}

#[test]
fn numbers_of_every_type_are_read_and_set() {
    const KINDS: [Kind; 12] = [
        Kind::Float64,
        Kind::Float32,
        Kind::Int8,
        Kind::UInt8,
        Kind::Int16,
        Kind::UInt16,
        Kind::Int32,
        Kind::UInt32,
        Kind::Int64,
        Kind::Enumeration,
        Kind::UInt64,
        Kind::Boolean,
    ];
    let folder = tempfile::tempdir().unwrap();
    let mut slave = of_each_type(folder.path());
    let [byte, short, int, long] = [8, 16, 32, 64].map(|bits| 2_f64.powi(bits) - 2.0);
    let at_start = [
        -2.0, -2.0, -2.0, byte, -2.0, short, -2.0, int, -2.0, -2.0, long, 1.0,
    ];
    let set = [
        0.5, 0.25, -8.0, 8.0, -16.0, 16.0, -32.0, 32.0, -64.0, -64.0, 64.0, 0.0,
    ];
    assert_eq!(
        KINDS.map(|kind| slave.number(kind, 1)),
        at_start.map(|value| (Status(0), value))
    );
    for (kind, value) in KINDS.into_iter().zip(set) {
        assert_eq!(slave.set_number(kind, 1, value), Status(0));
    }
    assert_eq!(
        KINDS.map(|kind| slave.number(kind, 1)),
        set.map(|value| (Status(0), value))
    );
}

#[test]
fn what_the_fmu_asks_for_after_a_step_or_an_update_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let mut slave = of_each_type(folder.path());
    // It does not write the time after a complete step.
    for (asks, reached_seconds, is_event, is_terminated) in [
        (0.0, 0.75, false, false),
        (1.0, 0.625, true, false),
        (2.0, 0.75, false, true),
    ] {
        slave.set_number(Kind::Int32, 1, asks);
        let stepped = Stepped {
            status: Status(0),
            reached_seconds,
            needs_events: is_event,
            is_terminated,
        };
        assert_eq!(slave.step(0.5, 0.25), stepped);
        let updated = Updated {
            again: is_event,
            is_terminated,
            next_event_seconds: is_event.then_some(2.0),
        };
        assert_eq!(slave.update_discrete(), (Status(0), updated));
    }
}

#[test]
fn why_a_library_cannot_be_loaded_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let library = folder.path().join("a.so");
    let mut elsewhere = *b"\x7fELF                ";
    elsewhere[18..].copy_from_slice(&243_u16.to_ne_bytes());
    // The system names the file.
    let name = library.to_string_lossy();
    for (bytes, said) in [
        (&elsewhere[..], "it is for RISC-V, and this is "),
        (b"no library", &*name),
    ] {
        fs::write(&library, bytes).unwrap();
        let text = open(&library).unwrap_err().to_string();
        let said = format!("its library cannot be loaded: {said}");
        assert!(text.starts_with(&said), "{text}");
    }
}

#[test]
fn a_library_finds_the_symbols_of_python() {
    let folder = tempfile::tempdir().unwrap();
    let python = compiled(folder.path(), "python", "int Py_Probe;");
    let code = "extern int Py_Probe; int *probe(void) { return &Py_Probe; }";
    let library = compiled(folder.path(), "library", code);
    assert!(python::open_if_there(&python));
    open(&library).unwrap();
}
