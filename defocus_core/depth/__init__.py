"""Depth maps: conversion to planar depth; repair of noise, edges and quantised levels."""
