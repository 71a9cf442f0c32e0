//! Integration tests of questions to servers.

mod dialects;
mod mangled;
mod names;
mod server;
