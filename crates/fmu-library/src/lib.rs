//! The shared library that `canrig fmu --export` puts into the FMUs of the plants that ship. Its C functions are those of
//! `fmu::export`, its models those of `fmu_plants`.

fmu::export!(fmu_plants::shipped);
