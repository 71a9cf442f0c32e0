//! Integration tests of sms-robots.

mod capsules;
mod dynamics;
mod ik;
mod oracle;
mod osc;
mod other_robots;
mod program;
mod strike;
mod urdf;
