# wcsim in containers. Targets, by --target:
#   world   a world that others join (`wcsim serve`), without PyTorch: docs/clients.md
#   client  one network in such a world (`wcsim join`), or any other command
#   cuda    a client with an NVIDIA card; not built and not tried, for want of one
#   node    the default: `make demo`, or a node of a Ray cluster: docs/cluster.md
# All of them need --shm-size=1g. `compose.yaml` starts a world and two clients.
ARG BASE=python:3.11-slim-bookworm
FROM $BASE AS base
RUN apt-get update \
 && apt-get install --yes --no-install-recommends make libgl1 libxext6 libxrender1 libatomic1 \
 && rm -rf /var/lib/apt/lists/*
# Its owner alone may read the token of a cluster, so a node's user has the number of whose token it is: docs/cluster.md
ARG USER_ID=1000
# A volume that is mounted here belongs to the same user.
RUN useradd --create-home --uid "$USER_ID" wcsim && install --directory --owner=wcsim --group=wcsim /home/wcsim/wcsim /keys /runs
USER wcsim
WORKDIR /home/wcsim/wcsim
COPY --chown=wcsim:wcsim . .
ENV OMP_NUM_THREADS=1 PATH=/home/wcsim/wcsim/.venv/bin:$PATH

FROM base AS world
RUN python3 -m venv .venv && pip install --no-cache-dir --constraint constraints.txt .
ENTRYPOINT ["wcsim"]
CMD ["doctor"]

FROM world AS client
# Of a mirror of one's own: --build-arg TORCH_INDEX=ADDRESS
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
RUN pip install --no-cache-dir --constraint constraints.txt --extra-index-url "$TORCH_INDEX" '.[train]'

FROM world AS cuda
# Packages of pip's own index bring CUDA; the host brings the driver and its container toolkit.
RUN pip install --no-cache-dir --constraint constraints.txt '.[train]'
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility

FROM base AS node
# Of a mirror of one's own, as above; with nothing after the = pip takes what its configuration says.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
RUN make setup TORCH_INDEX="$TORCH_INDEX"
CMD ["make", "demo"]
