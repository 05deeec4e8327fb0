//! Plots, montages, tables and the HTML report.
